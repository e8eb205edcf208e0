"""Trials of an exported policy on one course, as in the ramp check: random starts, one command.

Straight ahead the course is level ground and then a ramp. A robot that is asked to stand, to walk backward or to a
side, or to turn, starts on the slope.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from humoslope.deploy.conditions import NOMINAL, Conditions
from humoslope.deploy.contract import Contract, Steering
from humoslope.deploy.controller import Controller, OnnxPolicy
from humoslope.deploy.gait import SWING_S, Gait, GaitRecorder, mean_gait
from humoslope.deploy.quantities import Array
from humoslope.deploy.world import World
from humoslope.errors import UserError
from humoslope.ranges import Checked, Count, Positive, Range, Seed
from humoslope.statistics import Proportion, mean, proportion

SETTLE_S = 2.0
"""Time before speed, creep and steps count, s; the robot starts from rest, a centimetre above the ground."""
FRICTION, FRICTION_MARGIN = 0.8, 0.3
"""Smallest friction between feet and ground, and its margin over the tangent of the grade; as in the ramp check."""
ALONG, ACROSS, YAW, JOINTS = 0.15, 0.5, 0.3, 0.05
"""Half-widths of the random starts, m and rad; as in the ramp check."""
STEEPEST = 60.0
FASTEST = 10.0
Slope = Annotated[float, Range(-STEEPEST, STEEPEST)]
"""An inclination, degrees."""
Speed = Annotated[float, Range(-FASTEST, FASTEST)]


@dataclass(frozen=True)
class TrialCfg(Checked):
    """Course, command and number of the trials.

    Attributes:
        grade: Grade of the ramp, degrees; negative goes down, 0 is flat ground.
        speed: Commanded forward speed, m/s; negative is backward. 0 asks the robot to stand, unless it is to walk to a
            side or to turn.
        seconds: Length of a trial, s. A window stays open until it is closed.
        trials: Number of trials, each from another random start. More than one need --headless.
        seed: Seed of the random starts.
        cross: Slope of the ground across the course, degrees; positive rises to the left. Only without a ramp.
        yaw_rate: Commanded yaw rate, rad/s, positive to the left; by default that which keeps it on the course. Needs
            --headless.
        lateral: Commanded speed to the left, m/s; negative is to the right. Needs --headless.
    """

    VERB: ClassVar[str] = "play"

    grade: Slope = 0.0
    speed: Speed = 0.5
    seconds: Positive = 20.0
    trials: Count = 1
    seed: Seed = 0
    cross: Slope = 0.0
    yaw_rate: Annotated[float, Range(-FASTEST, FASTEST)] | None = None
    lateral: Speed = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.grade and self.cross:
            raise UserError(f"--cross {self.cross:g} and --grade {self.grade:g} cannot be combined; one must be 0.")

    @property
    def stands(self) -> bool:
        """True if the robot is asked to stand."""
        return self.speed == self.lateral == 0.0 and not self.yaw_rate

    @property
    def straight(self) -> bool:
        """True if the robot is asked to walk straight ahead, which it begins on level ground."""
        return self.speed > 0.0 and self.lateral == 0.0 and self.yaw_rate is None

    @property
    def friction(self) -> float:
        """Coefficient of friction between feet and ground."""
        return max(FRICTION, math.tan(math.radians(abs(self.grade or self.cross))) + FRICTION_MARGIN)

    @property
    def length(self) -> float:
        """Length of the ramp, m: twice the commanded distance, and a reserve."""
        return 20.0 + 2.0 * abs(self.speed) * self.seconds


@dataclass(frozen=True)
class Trial:
    """Result of one trial. Positions count up to the last step before a fall.

    Attributes:
        fell: True if the trial ended in a fall.
        seconds: Duration, s.
        distance: Distance covered along the course, on its surface, m.
        speed: Mean speed along the course after `SETTLE_S`, m/s; NaN if the trial did not last that long.
        drift: Distance on the ground, in any direction, between the start and the end, m.
        creep: The same between `SETTLE_S` and the end, per second, m/s; NaN if the trial did not last that long.
        step_rate: Touchdowns of all feet per second after `SETTLE_S`, 1/s; NaN if the trial did not last that long.
        lateral_speed: Mean speed across the course after `SETTLE_S`, on its surface and to the left, m/s; NaN if the
            trial did not last that long.
        heading_speed: Mean horizontal speed in the direction of the root's heading after `SETTLE_S`, m/s; NaN if the
            trial did not last that long.
        yaw_rate: Mean yaw rate after `SETTLE_S`, rad/s; NaN if the trial did not last that long.
        gait: How it walked after `SETTLE_S`.
    """

    fell: bool
    seconds: float
    distance: float
    speed: float
    drift: float
    creep: float
    step_rate: float
    lateral_speed: float
    heading_speed: float
    yaw_rate: float
    gait: Gait


@dataclass(frozen=True)
class Summary:
    """Several trials together; None for a mean over no trial.

    Attributes:
        falls: Share of trials that ended in a fall, with Wilson's interval.
        speed: Mean of the trials' speeds, m/s.
        distance: Mean distance along the course, m.
        drift: Mean drift, m.
        creep: Mean creep, m/s.
        step_rate: Mean rate of touchdowns, 1/s.
        lateral_speed: Mean speed to the left, m/s.
        yaw_rate: Mean yaw rate, rad/s.
        gait: Means of the trials' gaits; NaN for one over no trial.
    """

    falls: Proportion
    speed: float | None
    distance: float
    drift: float
    creep: float | None
    step_rate: float | None
    lateral_speed: float | None
    yaw_rate: float | None
    gait: Gait


class TouchdownCounter:
    """Counts touchdowns of F feet: contacts that begin after at least `SWING_S` without one.

    Args:
        feet: Number of feet F.
        dt: Time between samples, s.

    Attributes:
        count: Touchdowns so far.
    """

    def __init__(self, feet: int, dt: float) -> None:
        self._steps_off = np.zeros(feet, dtype=np.int64)  # samples since each foot was last down
        self._least = max(1, round(SWING_S / dt))
        self.count = 0

    def add(self, down: NDArray[np.bool_]) -> None:
        """Adds a sample: which feet are down, [F]."""
        self.count += int((down & (self._steps_off >= self._least)).sum())
        self._steps_off = np.where(down, 0, self._steps_off + 1)


class Player:
    """A policy, its robot, and the course below it.

    Args:
        folder: The export folder.
        contract: The contract in it.
        cfg: Course and command.
        conditions: Disturbances.
        model: MJCF of another robot with joints of the same names, in place of the export's own.

    Raises:
        UserError: If a file of the export is missing or broken, or they do not belong together.
    """

    def __init__(
        self,
        folder: Path,
        contract: Contract,
        cfg: TrialCfg,
        conditions: Conditions = NOMINAL,
        model: Path | None = None,
    ) -> None:
        self.contract, self.cfg, self.conditions = contract, cfg, conditions
        self.controller = Controller(contract, OnnxPolicy(folder, contract.network))
        self.target = np.array([joint.default_rad for joint in contract.joints])  # [J] the last one, rad
        self.world = World(
            folder, contract, cfg.grade, cfg.friction, cfg.length, cfg.cross, conditions, model, run_up=cfg.straight
        )

    def start(self, rng: np.random.Generator | None = None) -> None:
        """Places the robot at the start, with a random offset of place and pose if `rng` is given."""
        self.controller.reset()
        if rng is None:
            self.world.reset()
            return
        x, y, yaw = rng.uniform(-1.0, 1.0, 3) * (ALONG, ACROSS, YAW)
        self.world.reset(x, y, yaw, rng.uniform(-JOINTS, JOINTS, len(self.contract.joints)))

    def step(self, command: Array) -> None:
        """Advances by one control step under a command [3] (forward, left, yaw rate)."""
        measured = self.world.measured(command, self.controller.last_action)
        self.target = self.controller(measured)
        self.world.step(self.target)

    def course_command(self) -> Array:
        """Returns the command [3] that `cfg` asks for. Straight ahead it keeps the robot on the course, backward and to
        the sides it holds its heading; zeros ask it to stand."""
        cfg = self.cfg
        if cfg.stands:
            return np.zeros(3)
        if cfg.yaw_rate is not None:
            return np.array([cfg.speed, cfg.lateral, cfg.yaw_rate])
        left = self.world.root_pos[1] if cfg.straight else 0.0
        return np.array([cfg.speed, cfg.lateral, steer(self.contract.commands.steering, left, self.world.yaw)])

    def run_trial(self, rng: np.random.Generator) -> Trial:
        """Runs one trial from a random start."""
        self.start(rng)
        dt, world = self.contract.timing.control_step_s, self.world
        steps, settle = round(self.cfg.seconds / dt), round(SETTLE_S / dt)
        begin = settled = end = self._place()
        touchdowns, lasted = TouchdownCounter(len(world.foot_bodies), dt), steps
        gait = GaitRecorder([joint.name for joint in self.contract.joints], dt)
        headway = turned = 0.0
        push_steps = max(1, round(self.conditions.push_every_s / dt)) if self.conditions.push_m_s else steps + 1
        for done in range(1, steps + 1):
            if done > 1 and (done - 1) % push_steps == 0:
                direction = rng.uniform(-math.pi, math.pi)
                world.push(self.conditions.push_m_s * np.array([math.cos(direction), math.sin(direction), 0.0]))
            (x, y), yaw = world.root_pos[:2], world.yaw
            self.step(self.course_command())
            if world.fallen():
                lasted = done - 1
                break
            end, down = self._place(), world.feet_down()
            touchdowns.add(down)
            if done <= settle:
                settled, touchdowns.count = end, 0
                continue
            gait.add(self.target, world.joint_pos, down, world.touches_itself())
            headway += (world.root_pos[0] - x) * math.cos(yaw) + (world.root_pos[1] - y) * math.sin(yaw)
            turned += math.remainder(world.yaw - yaw, 2.0 * math.pi)
        fell = lasted < steps
        measured_s = (lasted - settle) * dt if lasted > settle else math.nan
        return Trial(
            fell=fell,
            seconds=(lasted + fell) * dt,
            distance=float(end[0] - begin[0]),
            speed=float(end[0] - settled[0]) / measured_s,
            drift=float(np.linalg.norm(end - begin)),
            creep=float(np.linalg.norm(end - settled)) / measured_s,
            step_rate=touchdowns.count / measured_s,
            lateral_speed=float(end[1] - settled[1]) / measured_s,
            heading_speed=headway / measured_s,
            yaw_rate=turned / measured_s,
            gait=gait.gait(),
        )

    def _place(self) -> Array:
        """Place of the root on the ground, [2] m: along the course and across it."""
        x, y, _ = self.world.root_pos
        return np.array([self.world.along(x), y / math.cos(self.world.cross)])


def steer(steering: Steering, left: float, yaw: float) -> float:
    """Returns the yaw rate, rad/s, that leads back to the course by the contract's law.

    Args:
        steering: Gains and limit of the law.
        left: Offset to the left of the course, m.
        yaw: Heading relative to the course, rad.
    """
    error = math.remainder(-steering.lateral_gain_rad_m * left - yaw, 2.0 * math.pi)
    return max(-steering.limit_rad_s, min(steering.limit_rad_s, steering.heading_gain_per_s * error))


def run_trials(player: Player) -> Iterator[Trial]:
    """Runs the trials one after the other. The random start of a trial does not depend on how many there are."""
    for trial in range(player.cfg.trials):
        yield player.run_trial(np.random.default_rng((player.cfg.seed, trial)))


def summarise(trials: Sequence[Trial]) -> Summary:
    """Returns the share of falls and the means of the trials."""

    def over(name: str) -> float | None:
        return mean(np.array([getattr(trial, name) for trial in trials]))

    return Summary(
        falls=proportion(sum(trial.fell for trial in trials), len(trials)),
        speed=over("speed"),
        distance=float(np.mean([trial.distance for trial in trials])),
        drift=float(np.mean([trial.drift for trial in trials])),
        creep=over("creep"),
        step_rate=over("step_rate"),
        lateral_speed=over("lateral_speed"),
        yaw_rate=over("yaw_rate"),
        gait=mean_gait([trial.gait for trial in trials]),
    )
