"""A simulated robot behind the messages of a real one: MuJoCo, a gantry, motors, and faults on request.

Each motor computes its torque at every physics step from the last command and its present state, as on the robot, so
that a command that is lost or late acts as it would there.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from humoslope.deploy.conditions import Conditions
from humoslope.deploy.contract import Contract
from humoslope.deploy.onboard.messages import Command, Inbox, Reading, Remote
from humoslope.deploy.onboard.unitree_g1 import MODE_MACHINE
from humoslope.deploy.quantities import Array
from humoslope.deploy.world import World
from humoslope.errors import UserError, unknown
from humoslope.ranges import Checked, Finite, NotNegative, Share

GANTRY_N_M, GANTRY_NS_M = 4000.0, 400.0
"""Stiffness and damping of the rope in each direction, of a robot of 35 kg."""
GANTRY_NM_RAD, GANTRY_NMS_RAD = 200.0, 20.0
"""Stiffness and damping with which it keeps the root upright and from spinning."""
LIFTED_M = 0.15
"""Height at which the robot hangs above standing, m."""
LOWERED_M_S = 0.2
"""Speed at which it is lowered, m/s."""
LIMP_FRICTION = 0.05
"""Dry friction of a joint whose motor does not hold, as a share of its effort limit. Ours: without any, the joints of a
robot that hangs limp swing to their stops."""
NOISE_RAD, NOISE_RAD_S = 1e-5, 1e-4
"""Standard deviation of the noise of encoders and gyroscope: enough to tell a message from the one before."""


@dataclasses.dataclass(frozen=True)
class Faults(Checked):
    """What is wrong with the robot's messages. The defaults are a sound robot.

    Attributes:
        delay_s: Age of every message when it is sent, s.
        imu_delay_s: Additional age of the IMU's part, s.
        drop: Share of messages that are lost.
        corrupt: Share of messages with one absurd number.
        silent_at_s: Time after which the robot says nothing more, s; by default never.
        swap: Names of two joints whose encoders are exchanged, such as left_knee_joint right_knee_joint.
        mirrored: Left and right joints are exchanged.
        flip: Name of a joint whose encoder counts backward.
        velocity_scale: Factor on joint velocities.
        gyro_sign: Factor on the gyroscope, -1 for one that turns the wrong way.
        imu_tilt_deg: Rotation of the IMU about the root's x and y axes, degrees.
        stiffness_scale: Factor on the stiffness that the motors apply.
        damping_scale: Factor on the damping that the motors apply.
        command_delay_s: Time until a command acts, s.
        mode_machine: Code of the build that the robot says it is.
        temperature_c: Temperature of every motor, degrees Celsius.
        error: Error code of the first motor.
    """

    VERB: ClassVar[str] = "faults"

    delay_s: NotNegative = 0.0
    imu_delay_s: NotNegative = 0.0
    drop: Share = 0.0
    corrupt: Share = 0.0
    silent_at_s: NotNegative | None = None
    swap: tuple[str, ...] = ()
    mirrored: bool = False
    flip: str = ""
    velocity_scale: Finite = 1.0
    gyro_sign: Finite = 1.0
    imu_tilt_deg: tuple[float, float] = (0.0, 0.0)
    stiffness_scale: NotNegative = 1.0
    damping_scale: NotNegative = 1.0
    command_delay_s: NotNegative = 0.0
    mode_machine: int = MODE_MACHINE
    temperature_c: Finite = 35.0
    error: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.swap and len(self.swap) != 2:
            raise UserError(f"faults: swap needs two joints, not {len(self.swap)}.")


SOUND = Faults()


class SimulatedRobot:
    """A robot in plain MuJoCo that is told what its motors do, and says what its sensors read.

    Attributes:
        world: The robot and its ground.
        commands: Number of commands received.
        hung: True while the gantry carries it.

    Args:
        folder: The export folder.
        contract: The contract in it.
        grade: Grade of the ground, degrees.
        cross: Slope across the course, degrees.
        friction: Coefficient of friction between feet and ground.
        faults: What is wrong with its messages.
        lifted: Height at which it hangs on the gantry at first, above standing, m.
        seed: Seed of noise and lost messages.
        timestep_s: Physics step; the contract's by default.
        length: Length of a ramp, m.
    """

    def __init__(
        self,
        folder: Path,
        contract: Contract,
        grade: float = 0.0,
        cross: float = 0.0,
        friction: float = 1.0,
        faults: Faults = SOUND,
        lifted: float = LIFTED_M,
        seed: int = 0,
        timestep_s: float | None = None,
        length: float = 60.0,
    ) -> None:
        tilt = (math.radians(faults.imu_tilt_deg[0]), math.radians(faults.imu_tilt_deg[1]))
        conditions = Conditions(imu_tilt_rad=tilt, timestep_s=timestep_s)
        self.world = World(folder, contract, grade, friction, length, cross, conditions)
        self._contract, self.faults = contract, faults
        self._rng = np.random.default_rng(seed)
        model, joints = self.world.model, contract.joints
        self._dt = float(model.opt.timestep)
        self._limit = np.array([joint.effort_limit_nm for joint in joints])
        self._positions = np.array([model.joint(joint.name).qposadr[0] for joint in joints])
        self._dofs = np.array([model.joint(joint.name).dofadr[0] for joint in joints])
        self._order, self._sign = _encoders(contract, faults)
        self._root = int(model.body(contract.robot.root_body).id)
        self._steps = 0
        self._waiting: deque[tuple[int, Command]] = deque()
        self._motors(Command(np.zeros(len(joints)), np.zeros(len(joints)), np.zeros(len(joints))))
        self.commands, self.hung, self._lowering = 0, True, False
        self.remote = Remote()
        rest = self.world.data.qpos[self.world.free_pos : self.world.free_pos + 3].copy()
        self._hook, self._standing = rest + np.array([0.0, 0.0, lifted]), rest[2]
        self.world.data.qpos[self.world.free_pos + 2] += lifted
        mujoco.mj_forward(model, self.world.data)
        self._messages: deque[Reading] = deque(maxlen=1 + round(1.0 / self._dt))
        self._count = 0
        self._messages.append(self._sense())

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._steps * self._dt

    @property
    def mass(self) -> float:
        """Mass of the robot, kg."""
        return float(self.world.model.body_subtreemass[self._root])

    def lower(self) -> None:
        """Lowers the robot until its feet carry it. The rope still steadies it: a pose alone does not balance."""
        self._lowering = True

    def release(self) -> None:
        """Takes the rope off."""
        self.hung = False
        self.world.data.xfrc_applied[self._root] = 0.0

    def receive(self, command: Command) -> None:
        """Takes a command; it acts after the fault's delay."""
        self.commands += 1
        self._waiting.append((self._steps + round(self.faults.command_delay_s / self._dt), command))

    def step(self) -> None:
        """One physics step."""
        while self._waiting and self._waiting[0][0] <= self._steps:
            self._motors(self._waiting.popleft()[1])
        data = self.world.data
        if self.hung:
            self._pull()
        mujoco.mj_step(self.world.model, data)
        self._steps += 1
        self._messages.append(self._sense())

    def say(self) -> Reading | None:
        """Returns the message that is sent at this instant, with its faults; None if none is."""
        faults = self.faults
        if faults.silent_at_s is not None and self.time >= faults.silent_at_s:
            return None
        if self._rng.random() < faults.drop:
            return None
        reading = self._before(faults.delay_s)
        imu = self._before(faults.delay_s + faults.imu_delay_s)
        self._count += 1
        joints, noise = len(self._contract.joints), self._rng.normal
        changed = dataclasses.replace(
            reading,
            count=self._count,
            quat_w=imu.quat_w,
            ang_vel_b=faults.gyro_sign * (imu.ang_vel_b + noise(0.0, NOISE_RAD_S, 3)),
            joint_pos=reading.joint_pos + noise(0.0, NOISE_RAD, joints),
            joint_vel=faults.velocity_scale * (reading.joint_vel + noise(0.0, NOISE_RAD_S, joints)),
            remote=self.remote,
        )
        if self._rng.random() < faults.corrupt:
            absurd = changed.joint_pos.copy()
            absurd[self._rng.integers(joints)] = math.nan
            changed = dataclasses.replace(changed, joint_pos=absurd)
        return changed

    @property
    def damped(self) -> bool:
        """True while the motors damp and do not hold."""
        return not self._now.stiffness.any() and bool(self._now.damping.any())

    @property
    def held(self) -> bool:
        """True while the motors follow targets."""
        return bool(self._now.stiffness.any())

    def _motors(self, command: Command) -> None:
        model, faults = self.world.model, self.faults
        self._now = command
        stiffness, damping = faults.stiffness_scale * command.stiffness, faults.damping_scale * command.damping
        model.actuator_gainprm[:, 0] = stiffness
        model.actuator_biasprm[:, 1] = -stiffness
        model.actuator_biasprm[:, 2] = -damping
        model.dof_frictionloss[self._dofs] = 0.0 if stiffness.any() else LIMP_FRICTION * self._limit
        self.world.data.ctrl[:] = command.target

    def _pull(self) -> None:
        """Force and torque of the gantry on the root."""
        data, p, v = self.world.data, self.world.free_pos, self.world.free_vel
        weight = self.mass * 9.81
        carried = self.world.foot_forces().sum() if self._lowering else 0.0
        if self._lowering and carried < 0.8 * weight:
            self._hook[2] -= LOWERED_M_S * self._dt
        pull = GANTRY_N_M * (self._hook - data.qpos[p : p + 3]) - GANTRY_NS_M * data.qvel[v : v + 3]
        pull[2] = max(0.0, pull[2] + max(0.0, weight - carried))  # a rope does not push
        turn = np.zeros(3)
        quat = data.qpos[p + 3 : p + 7]
        mujoco.mju_quat2Vel(turn, quat, 1.0)
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, quat)
        spin_w = rotation.reshape(3, 3) @ data.qvel[v + 3 : v + 6]
        data.xfrc_applied[self._root] = [*pull, *(-GANTRY_NM_RAD * turn - GANTRY_NMS_RAD * spin_w)]

    def _sense(self) -> Reading:
        """What the sensors read at present, without noise and without the faults of the wire."""
        world, joints = self.world, len(self._contract.joints)
        world.look_now()
        seen = world.measured(np.zeros(3), np.zeros(joints))
        default = np.array([joint.default_rad for joint in self._contract.joints])
        errors = np.zeros(joints)
        errors[0] = self.faults.error
        return Reading(
            count=0,
            quat_w=seen.root_quat_w.copy(),
            ang_vel_b=seen.root_ang_vel_b.copy(),
            joint_pos=(self._sign * (seen.joint_pos_rel + default))[self._order],
            joint_vel=(self._sign * seen.joint_vel)[self._order],
            torque=self._torque(),
            temperature=np.full(joints, self.faults.temperature_c),
            errors=errors,
            mode_machine=self.faults.mode_machine,
            remote=Remote(),
        )

    def _torque(self) -> Array:
        """What the motors give at present; MuJoCo has that of the step before."""
        model, data = self.world.model, self.world.data
        position, velocity = data.qpos[self._positions], data.qvel[self._dofs]
        torque = model.actuator_gainprm[:, 0] * (data.ctrl - position) + model.actuator_biasprm[:, 2] * velocity
        return np.clip(torque, -self._limit, self._limit)

    def _before(self, age_s: float) -> Reading:
        steps = min(round(age_s / self._dt), len(self._messages) - 1)
        return self._messages[-1 - steps]


def _encoders(contract: Contract, faults: Faults) -> tuple[NDArray[np.int64], Array]:
    """Which joint each reported encoder belongs to, [J], and the sense in which each joint's encoder counts, [J]."""
    names = [joint.name for joint in contract.joints]
    order, sign = np.arange(len(names), dtype=np.int64), np.ones(len(names))
    for name in (*faults.swap, *([faults.flip] if faults.flip else [])):
        if name not in names:
            raise unknown("joint", name, names)
    if faults.swap:
        a, b = (names.index(name) for name in faults.swap)
        order[[a, b]] = order[[b, a]]
    if faults.mirrored:
        other = [n.replace("left", "\0").replace("right", "left").replace("\0", "right") for n in names]
        order = order[[names.index(name) for name in other]]
    if faults.flip:
        sign[names.index(faults.flip)] = -1.0
    return order, sign


class InProcessLink:
    """A link to a simulated robot in the same process and at the same time: the robot steps when the clock does.

    Args:
        robot: The robot.
        on_step: Called after each physics step, for what a person does beside the robot.
    """

    def __init__(self, robot: SimulatedRobot, on_step: Callable[[SimulatedRobot], object] = lambda robot: None) -> None:
        self.robot, self._on_step = robot, on_step
        self._inbox = Inbox()
        self.others = False

    def clock(self) -> float:
        """Simulated time, s."""
        return self.robot.time

    def run(self, seconds: float) -> None:
        """Lets time pass."""
        for _ in range(round(seconds / float(self.robot.world.model.opt.timestep))):
            self.robot.step()
            self._on_step(self.robot)
            if (reading := self.robot.say()) is not None:
                self._inbox.add(self.clock(), reading)

    def read(self, age_s: float = 0.0) -> Reading | None:
        """See `Link`."""
        return self._inbox.read(self.clock(), age_s)

    def write(self, command: Command) -> None:
        """See `Link`."""
        self.robot.receive(command)

    def foreign(self) -> bool:
        """See `Link`."""
        return self.others

    def close(self) -> None:
        """See `Link`."""
