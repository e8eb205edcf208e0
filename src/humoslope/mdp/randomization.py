"""Randomisation of drives, links, contact and sensors, as differences between the model and a real robot.

Every event acts on the envs in `mask` [N] and may run at startup or at any reset; terms that change the same model
field combine, in any order. Ranges that peers use are given as examples; none is a default.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import torch
from torch import Tensor

from humoslope.mdp.selection import Joints, joint_mask
from humoslope.ranges import NotNegative, NotNegativeSpan, PositiveSpan, Range
from humoslope.scene.measurements import ROUNDING
from humoslope.sim.fields import replace
from humoslope.slope import quaternion

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


@dataclass(frozen=True)
class WithinDelayBuffer:
    """Declaration of a range of control delays for which the model must have room."""

    def fault(self, value: Any, env: Any) -> str | None:
        """See `humoslope.ranges.Declaration.fault`."""
        if env is None or Range(0.0).fault(value) is not None or value[1] <= env.cfg.sim.max_control_delay_s:
            return None
        return f"sim.max_control_delay_s must be at least {value[1]:g}, and it is {env.cfg.sim.max_control_delay_s:g}"


@dataclass(frozen=True)
class AtLeastPhysicsSteps:
    """Declaration of a range of durations of at least `steps` physics steps; `reason` ends the message."""

    steps: int
    reason: str

    def fault(self, value: Any, env: Any) -> str | None:
        """See `humoslope.ranges.Declaration.fault`."""
        if env is None or Range(0.0, open_low=True).fault(value) is not None:
            return None
        least = self.steps * env.cfg.sim.timestep
        return None if value[0] >= least * (1.0 - ROUNDING) else f"it must be {least:g} s or more, {self.reason}"


def randomize_control_delay(env: Env, mask: Tensor, delay: Annotated[NotNegativeSpan, WithinDelayBuffer()]) -> None:
    """Delays the controls of an env, all joints alike, by a whole number of physics steps.

    It is MuJoCo's `actuator_delay`, whose buffers `sim.max_control_delay_s` makes room for. Joint targets that held
    before the episode are those of the reset. Peers: 0 to 1 control steps in holosoma, 2 to 5 physics steps of 5 ms in
    the example of mjlab's actuators.

    Args:
        delay: Range of the delay, s; rounded to physics steps.
    """
    dt = env.cfg.sim.timestep
    steps = (env.uniform(*delay, 1) / dt).round()
    # A sample counts from its own time until the next one's. Half a step less asks for the middle of that interval,
    # where the rounding of the clock (2e-6 s after 20 s in float32) cannot pick the neighbour.
    replace(env.sim.expand("actuator_delay"), mask, ((steps - 0.5) * dt).clamp(min=0.0))


def randomize_observation_age(
    env: Env,
    mask: Tensor,
    age: Annotated[PositiveSpan, AtLeastPhysicsSteps(1, "one physics step, the age of the newest reading")],
) -> None:
    """Draws the age of the measurements that the policy sees, encoders and IMU alike: they come in one message.

    It concerns observations with `measured`. mjlab delays single terms by whole control steps.

    Args:
        age: Range of the age, s; not rounded to physics steps.
    """
    env.measurements.make_room(age[1])
    env.measurements.age_s = torch.where(mask, env.uniform(*age), env.measurements.age_s)


def randomize_encoder_bias(env: Env, mask: Tensor, bias: NotNegative, joints: Joints = ".*") -> None:
    """Draws a constant error of each joint encoder, which both the policy and the joint's position control measure.

    Peers: 0.015 rad in mjlab's G1 velocity task.

    Args:
        bias: Largest error, rad.
        joints: Joints with this error; the others keep theirs.
    """
    drawn = env.uniform(-bias, bias, env.robot.num_joints)
    env.drives.set(mask, encoder_bias=torch.where(_chosen(env, joints), drawn, env.drives.encoder_bias))


def randomize_imu_mounting(env: Env, mask: Tensor, tilt: NotNegative) -> None:
    """Turns the axes of the IMU away from those of the root, for angular velocity and gravity.

    mjlab offers the same as the orientation of the IMU's site, without a range for the G1.

    Args:
        tilt: Largest component of the rotation vector along each axis of the root, rad.
    """
    rotation = quaternion.matrix(quaternion.from_rotation_vector(env.uniform(-tilt, tilt, 3)))
    measurements = env.measurements
    measurements.imu_rotation = torch.where(mask[:, None, None], rotation, measurements.imu_rotation)


def randomize_gyro_bias(env: Env, mask: Tensor, bias: NotNegative) -> None:
    """Draws a constant offset of the gyroscope. Ours; no peer has it.

    Args:
        bias: Largest offset about each axis of the IMU, rad/s.
    """
    drawn = env.uniform(-bias, bias, 3)
    env.measurements.gyro_bias = torch.where(mask[:, None], drawn, env.measurements.gyro_bias)


def randomize_motor_strength(env: Env, mask: Tensor, strength: PositiveSpan, joints: Joints = ".*") -> None:
    """Scales the torque of each motor with its limit, each on its own, on top of `randomize_gains`.

    Peers: 0.9 to 1.1 in RMA (Kumar et al. 2021, arXiv 2107.04034, table of its environment).

    Args:
        strength: Range of the factor.
        joints: Joints whose motors vary; the others keep theirs.
    """
    drawn = env.uniform(*strength, env.robot.num_joints)
    env.drives.set(mask, strength=torch.where(_chosen(env, joints), drawn, env.drives.strength))


def randomize_armature(env: Env, mask: Tensor, factor: PositiveSpan, joints: Joints = ".*") -> None:
    """Scales the reflected inertia of each motor.

    Peers: 1 to 1.05 in MuJoCo Playground's G1.

    Args:
        factor: Range of the factor.
        joints: Joints whose motors vary; the others keep theirs.
    """
    drawn = env.drives.nominal_armature * env.uniform(*factor, env.robot.num_joints)
    _replace_joints(env, "dof_armature", mask, joints, drawn)
    env.sim.recompute_constants()


def randomize_joint_damping(env: Env, mask: Tensor, damping: NotNegativeSpan, joints: Joints = ".*") -> None:
    """Draws the viscous friction of each joint, which the strength of its motor does not scale. mjlab has it too.

    Args:
        damping: Range of the coefficient, Nm s/rad.
        joints: Joints with this damping; the others keep theirs.
    """
    _replace_joints(env, "dof_damping", mask, joints, env.uniform(*damping, env.robot.num_joints))


def randomize_joint_friction(env: Env, mask: Tensor, friction: NotNegativeSpan, joints: Joints = ".*") -> None:
    """Draws the dry friction of each joint. Each joint with friction adds a constraint row to the solver.

    Peers: half to twice the model's value in MuJoCo Playground's G1.

    Args:
        friction: Range of the torque, Nm.
        joints: Joints with this friction; the others keep theirs.
    """
    _replace_joints(env, "dof_frictionloss", mask, joints, env.uniform(*friction, env.robot.num_joints))


def randomize_link_masses(env: Env, mask: Tensor, factor: PositiveSpan) -> None:
    """Scales mass and inertia of every link, each on its own; `randomize_mass` adds to it.

    Peers: 0.9 to 1.1 in MuJoCo Playground's G1, 0.9 to 1.2 in holosoma.

    Args:
        factor: Range of the factor.
    """
    env.masses.expect(slice(1, None), factor=factor[0])
    env.masses.set(mask, slice(1, None), factor=env.uniform(*factor, env.sim.model.nbody - 1))


def randomize_contact_softness(
    env: Env,
    mask: Tensor,
    time_constant: Annotated[PositiveSpan, AtLeastPhysicsSteps(2, "two physics steps, to which MuJoCo raises it")],
) -> None:
    """Draws how soft feet and ground are, as the time constant of MuJoCo's `solref`, at the damping ratio of the model.

    A contact is a spring and damper whose penetration decays with this time constant; MuJoCo's default is 0.02 s. Ours;
    no peer has it.

    Args:
        time_constant: Range of the time constant, s.
    """
    field, drawn = env.sim.expand("geom_solref"), env.uniform(*time_constant)  # [N, G, 2]
    for side in env.robot.foot_geoms:
        for geom in side:
            replace(field[:, env.sim.model.geom(geom).id, 0], mask, drawn)


def _chosen(env: Env, joints: str) -> Tensor:
    return joint_mask(env.robot, joints, env.device) > 0.0


def _replace_joints(env: Env, field: str, mask: Tensor, joints: str, values: Tensor) -> None:
    """Writes `values` [N, J] of the chosen joints into a model field over degrees of freedom."""
    present = env.sim.expand(field)[:, 6:]  # without those of the root
    replace(present, mask, torch.where(_chosen(env, joints), values.to(present.dtype), present))
