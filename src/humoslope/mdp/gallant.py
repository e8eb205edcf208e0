"""Terms of Gallant (arXiv 2511.14625): a goal as the command, and rewards for going there at a pace of its own choice.

Re-implemented from its published numbers; what is kept, changed and left out is listed in docs/gallant.md. Rewards are
positive functions of which the task's weights make prizes or prices. Terms that other tasks have too are in `rewards`.
Where nothing else is said, a foot is the frame of its body, 3.5 cm above its sole, and heights are over the ground
below the point.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated
from xml.etree import ElementTree

import torch
from torch import Tensor

from humoslope.errors import UserError
from humoslope.managers.goal import GoalCommand
from humoslope.managers.terms import StatefulTerm
from humoslope.mdp import declare
from humoslope.mdp.declare import measured_as, mirrored_as, reads_bodies
from humoslope.mdp.selection import Body, JointPair, Joints, joint_mask, joint_pair
from humoslope.ranges import NotNegative, NotNegativeSpan, Positive, Range, Share
from humoslope.slope import quaternion

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

TOUCH = 0.1
"""Vertical force from which a foot counts as on the ground in `stance`, N."""
LEVER = 3.0
"""Horizontal over vertical force from which a foot has stumbled."""


def goal_of(env: Env) -> GoalCommand:
    """The goals of an environment.

    Raises:
        UserError: If its command is no goal.
    """
    if not isinstance(env.commands, GoalCommand):
        raise UserError("this term needs goals; set env.command to a GoalCommandCfg.")
    return env.commands


def _goal_image(env: Env, **params: object) -> declare.Image:
    return torch.arange(4), torch.tensor([1.0, -1.0, 1.0, 1.0])


@reads_bodies
@mirrored_as(_goal_image)
@measured_as("custom")
def goal_command(env: Env) -> Tensor:
    """Way to the goal in the torso's heading frame, forward and left, m, and time passed and left for it, s, [N, 4]."""
    goal = goal_of(env)
    torso = quaternion.matrix(env.signals.torso_quat_w)
    yaw = torch.atan2(torso[:, 1, 0], torso[:, 0, 0])
    x, y = (goal.goal_w - env.bodies.position(env.robot.torso_body)[:, :2]).unbind(dim=1)
    cos, sin = yaw.cos(), yaw.sin()
    return torch.stack([cos * x + sin * y, cos * y - sin * x, goal.elapsed_s, goal.left_s], dim=1)


# The way to the goal.


def velocity_direction(env: Env) -> Tensor:
    """Cosine of the angle between the root's horizontal velocity and the way to the goal; 1 at the goal."""
    goal, velocity = goal_of(env), env.signals.root_lin_vel_w[:, :2]
    to_goal = goal.to_goal_w
    lengths = velocity.norm(dim=1) * to_goal.norm(dim=1)
    cosine = (velocity * to_goal).sum(dim=1) / lengths.clamp(min=1e-6)
    return torch.where(goal.reached, 1.0, cosine)


def reach_goal(env: Env, free: NotNegative = 0.2) -> Tensor:
    """In the last part of a goal's time, 1 / (1 + d^2) with d the distance beyond what is free along x and along y.

    Args:
        free: Distance along each axis without a price, m.
    """
    goal = goal_of(env)
    beyond = (goal.to_goal_w.abs() - free).clamp(min=0.0).square().sum(dim=1)
    return (goal.left_s < goal.cfg.stay_s) / (1.0 + beyond)


def at_goal(env: Env) -> Tensor:
    """1 at the goal in the last part of its time, else 0."""
    goal = goal_of(env)
    return (goal.reached & (goal.left_s < goal.cfg.stay_s)).to(torch.float32)


def heading_off_goal(env: Env) -> Tensor:
    """Squared angle between the root's heading and the way to the goal, in half turns; 0 at the goal."""
    goal = goal_of(env)
    to_goal = goal.to_goal_w
    off = torch.atan2(to_goal[:, 1], to_goal[:, 0]) - env.signals.heading_w
    off = torch.remainder(off + torch.pi, 2.0 * torch.pi) - torch.pi
    return (off / torch.pi).square() * ~goal.reached


def off_pace(env: Env, pace: NotNegativeSpan) -> Tensor:
    """1 on the way while the root's horizontal speed is outside of a span, else 0.

    Args:
        pace: Lowest and highest speed, m/s.
    """
    speed = env.signals.root_lin_vel_w[:, :2].norm(dim=1)
    return (((speed <= pace[0]) | (speed >= pace[1])) & ~goal_of(env).reached).to(torch.float32)


def stance(env: Env) -> Tensor:
    """1 on exactly one foot on the way, and on both at the goal, else 0."""
    down = (env.signals.foot_force_w[:, :, 2] >= TOUCH).sum(dim=1)
    return (down == torch.where(goal_of(env).reached, 2, 1)).to(torch.float32)


# Posture.


@reads_bodies
def head_height(
    env: Env,
    target: NotNegative,
    head: NotNegative = 0.55,
    knees: JointPair = ".*_knee_joint",
    hips: JointPair = ".*_hip_pitch_joint",
) -> Tensor:
    """exp(-4 e^2) of the error e of the head's height in m, less 5 |e (s - 0.5)| for each of four joints.

    s is the place of a joint in its range, from straight to bent: a robot that is too high or too low should not reach
    the end of its legs' range.

    Args:
        target: Height of the head over the ground below it, m.
        head: Height of the head over the torso's frame, along the root's up axis, m.
        knees, hips: Joint patterns.
    """
    up = quaternion.matrix(env.signals.root_quat_w)[:, :, 2]
    place = torch.add(env.bodies.position(env.robot.torso_body), up, alpha=head)
    error = place[:, 2] - env.terrain.height(place[:, :2]) - target
    low, high = env.joint_range.unbind(dim=1)
    bent = (env.signals.joint_pos - low) / (high - low)
    knee, hip = (bent.index_select(1, joint_pair(env.robot, joints, env.device)) for joints in (knees, hips))
    # A hip flexes by a negative angle.
    off = (knee - 0.5).abs().sum(dim=1) + (0.5 - hip).abs().sum(dim=1)
    return torch.exp(-4.0 * error.square()) - 5.0 * off * error.abs()


def _lean(gravity_b: Tensor, backward: float, aside: float) -> Tensor:
    """Squared lean of a body in whose frame gravity has the direction `gravity_b` [N, 3]."""
    forward = torch.where(gravity_b[:, 0] < 0.0, backward * gravity_b[:, 0], gravity_b[:, 0])
    return forward.square() + (aside * gravity_b[:, 1]).square()


def pelvis_lean(env: Env, backward: Positive = 10.0, aside: Positive = 5.0) -> Tensor:
    """Squared sines of the root's lean from the vertical, some directions before squaring weighing more than others.

    Args:
        backward: Factor on a lean backward.
        aside: Factor on a lean to a side.
    """
    return _lean(env.signals.projected_gravity_b, backward, aside)


def torso_lean(env: Env, backward: Positive = 10.0, aside: Positive = 5.0) -> Tensor:
    """Squared sines of the torso's lean from the vertical, as `pelvis_lean`.

    Args:
        backward: Factor on a lean backward.
        aside: Factor on a lean to a side.
    """
    return _lean(-quaternion.matrix(env.signals.torso_quat_w)[:, 2], backward, aside)


def lin_vel_z_l2(env: Env) -> Tensor:
    """Squared vertical speed of the root in the world, (m/s)^2; climbing has its price."""
    return env.signals.root_lin_vel_w[:, 2].square()


def joint_deviation_l2(env: Env, joints: Joints) -> Tensor:
    """Squared distance of some joints from the default pose, summed, rad^2.

    Args:
        joints: Regular expression on whole joint names.
    """
    return (env.signals.joint_pos - env.default_joint_pos).square() @ joint_mask(env.robot, joints, env.device)


@reads_bodies
def lateral_distance(env: Env, lefts: tuple[Body, ...], rights: tuple[Body, ...], span: NotNegativeSpan) -> Tensor:
    """Distance of left from right bodies across the heading, outside of a span, m.

    Several pairs are taken together: the sum of their distances, outside of as many spans.

    Args:
        lefts, rights: Bodies in the order of their pairs.
        span: Lowest and highest distance of a pair without a price, m.
    """
    if len(lefts) != len(rights) or not lefts:
        raise UserError(f"lateral_distance: there are {len(lefts)} left and {len(rights)} right bodies; give pairs.")
    heading = env.signals.heading_w
    side = torch.stack([-heading.sin(), heading.cos()], dim=1)
    total = torch.zeros_like(heading)
    for left, right in zip(lefts, rights, strict=True):
        apart = (env.bodies.position(left) - env.bodies.position(right))[:, :2]
        total = total + (apart * side).sum(dim=1).abs()
    low, high = (len(lefts) * bound for bound in span)
    return (low - total).clamp(min=0.0) + (total - high).clamp(min=0.0)


# Feet.


def _feet(env: Env) -> tuple[Tensor, Tensor]:
    """Positions [N, 2, 3] and rotations [N, 2, 3, 3] of the feet, world frame."""
    names = env.robot.foot_bodies
    positions = torch.stack([env.bodies.position(name) for name in names], dim=1)
    return positions, torch.stack([env.bodies.rotation(name) for name in names], dim=1)


def _heights(env: Env, points: Tensor) -> Tensor:
    """Heights of points [..., 3] over the ground below them, m."""
    return points[..., 2] - env.terrain.height(points[..., :2])


@reads_bodies
def feet_apart_in_yaw(env: Env) -> Tensor:
    """1 less the cosine of the angle between the headings of the feet."""
    forward = _feet(env)[1][..., :2, 0]  # [N, 2, 2]
    yaw = torch.atan2(forward[..., 1], forward[..., 0])
    return 1.0 - (yaw[:, 0] - yaw[:, 1]).cos()


SOLE = ((0.08, 0.0), (-0.02, 0.0), (0.0, 0.0), (0.0, 0.025), (0.0, -0.025))
"""Points of a foot that should be near the ground, forward and left of its frame, m."""


@reads_bodies
class SolePointsDown(StatefulTerm):
    """Number of points near the ground, of five for each foot that has touched it for longer than one control step.

    The points are in the plane of the foot's frame, and heights are vertical: the points of a foot that is flat on a
    slope are as high as its frame over the sole divided by the cosine of the slope, so that some 10 degrees of slope
    take all of this reward. As published.

    Args:
        near: Largest height of a point that counts, m; below the ground it does not count.
    """

    def __init__(self, env: Env, near: NotNegative = 0.035) -> None:
        self._near = near
        self._before = torch.zeros_like(env.signals.foot_contact)
        self._points = torch.tensor([(*point, 0.0) for point in SOLE], device=env.device)  # [5, 3]

    def __call__(self, env: Env) -> Tensor:
        contact = env.signals.foot_contact
        lasting, self._before = contact & self._before, contact
        position, rotation = _feet(env)
        points = position[:, :, None] + (rotation[:, :, None] @ self._points[:, :, None]).squeeze(-1)
        height = _heights(env, points)  # [N, 2, 5]
        near = (height >= 0.0) & (height <= self._near)
        return (near & lasting[:, :, None]).sum(dim=(1, 2)).to(torch.float32)

    def reset(self, mask: Tensor) -> None:
        """Forgets the contacts of the envs in `mask`."""
        self._before = self._before & ~mask[:, None]


def slip_l2(env: Env) -> Tensor:
    """Squared horizontal speed of the feet that touch the ground, summed, (m/s)^2."""
    speed = env.signals.foot_lin_vel_w[:, :, :2].square().sum(dim=2)
    return (speed * env.signals.foot_contact).sum(dim=1)


@reads_bodies
def low_swing(env: Env, target: NotNegative = 0.05, ahead: NotNegative = 0.15) -> Tensor:
    """Squared missing height of the feet times their horizontal speed relative to the root, summed, m^3/s.

    Height is over the mean of the ground below the foot and ahead of it, towards the goal.

    Args:
        target: Height of a foot from which nothing is missing, m.
        ahead: Distance of the second place, m.
    """
    to_goal = goal_of(env).to_goal_w
    direction = to_goal / to_goal.norm(dim=1, keepdim=True).clamp(min=1e-6)
    feet, _ = _feet(env)
    there = feet[:, :, :2]
    ground = env.terrain.height(torch.stack([there, torch.add(there, direction[:, None], alpha=ahead)], dim=2))
    missing = (target - (feet[:, :, 2] - ground.mean(dim=2))).clamp(min=0.0)
    speed = (env.signals.foot_lin_vel_w - env.signals.root_lin_vel_w[:, None])[:, :, :2].norm(dim=2)
    return (missing.square() * speed).sum(dim=1)


@reads_bodies
class PitchedLiftOff(StatefulTerm):
    """Squared difference of the heights of toe and heel as a foot leaves the ground, in the world and over the ground,
    summed over both and over the feet, m^2.

    Args:
        steps: Control steps after the foot has left the ground in which it counts.
        toe, heel: Places of toe and heel, forward and backward of the foot's frame, m.
    """

    def __init__(
        self,
        env: Env,
        steps: Annotated[int, Range(1, 1000)] = 3,
        toe: NotNegative = 0.12,
        heel: NotNegative = 0.06,
    ) -> None:
        self._steps, self._toe, self._heel = steps, toe, heel
        self._air = env.zeros(2)  # [N, 2] control steps since the foot was last down

    def __call__(self, env: Env) -> Tensor:
        self._air = (self._air + 1.0).masked_fill(env.signals.foot_contact, 0.0)
        position, rotation = _feet(env)
        forward = rotation[..., 0]  # [N, 2, 3]
        toe, heel = position + self._toe * forward, position - self._heel * forward
        world = toe[..., 2] - heel[..., 2]
        over = _heights(env, toe) - _heights(env, heel)
        leaving = (self._air > 0.0) & (self._air <= self._steps)
        return ((world.square() + over.square()) * leaving).sum(dim=1)

    def reset(self, mask: Tensor) -> None:
        """Forgets the times of the envs in `mask`; a foot that begins in the air has not just left the ground."""
        self._air = self._air.masked_fill(mask[:, None], float(self._steps))


def stumble(env: Env) -> Tensor:
    """1 where the ground pushes a foot more than three times as much to a side as up, else 0."""
    force = env.signals.foot_force_w
    return (force[..., :2].norm(dim=2) > LEVER * force[..., 2].abs()).any(dim=1).to(torch.float32)


def heavy_feet(env: Env, free: NotNegative = 250.0) -> Tensor:
    """Ground forces on both feet, each less what is free, summed, N; 0 if the sum is negative.

    Args:
        free: Force on a foot without a price, N.
    """
    return (env.signals.foot_force - free).sum(dim=1).clamp(min=0.0)


def landing_momentum(env: Env, free: NotNegative = 50.0) -> Tensor:
    """Downward speed of the feet times the vertical ground force beyond what is free, summed, W.

    Args:
        free: Force on a foot without a price, N.
    """
    down = (-env.signals.foot_lin_vel_w[..., 2]).clamp(min=0.0)
    return (down * (env.signals.foot_force_w[..., 2] - free).clamp(min=0.0)).sum(dim=1)


# Effort.


def body_force(env: Env) -> Tensor:
    """Ground force on everything but the feet, N."""
    return env.signals.body_force


def power_l2(env: Env) -> Tensor:
    """Squared mechanical power of the joints, summed, kW^2."""
    return (1e-3 * env.signals.joint_vel * env.signals.joint_torque).square().sum(dim=1)


def torque_over_stiffness_l2(env: Env) -> Tensor:
    """Squared torques, each over the joint's position gain, summed, rad^2."""
    return (env.signals.joint_torque / env.drives.nominal_stiffness).square().sum(dim=1)


class FastJoints(StatefulTerm):
    """Joint velocities beyond a share of the limits in the robot's URDF, summed, rad/s. Only positive ones count, as
    published.

    Args:
        share: Share of the limit without a price.
    """

    def __init__(self, env: Env, share: Share = 0.8) -> None:
        limits = {
            joint.get("name"): float(limit.get("velocity", "inf"))
            for joint in ElementTree.parse(env.robot.urdf).iter("joint")
            if (limit := joint.find("limit")) is not None
        }
        self._most = share * torch.tensor([limits[name] for name in env.robot.joint_names], device=env.device)

    def __call__(self, env: Env) -> Tensor:
        return (env.signals.joint_vel - self._most).clamp(min=0.0).sum(dim=1)

    def reset(self, mask: Tensor) -> None:
        """Nothing to forget."""


class StrongJoints(StatefulTerm):
    """Torques beyond a share of the joints' limits, summed, Nm. Only positive ones count, as published.

    Args:
        share: Share of the limit without a price.
    """

    def __init__(self, env: Env, share: Share = 0.95) -> None:
        self._most = share * torch.tensor(env.robot.effort_limit, device=env.device)

    def __call__(self, env: Env) -> Tensor:
        return (env.signals.joint_torque - self._most).clamp(min=0.0).sum(dim=1)

    def reset(self, mask: Tensor) -> None:
        """Nothing to forget."""


# Terminations.


def hit(env: Env, force: NotNegative) -> Tensor:
    """Termination: the ground presses hard on anything but the feet.

    Args:
        force: Force above which it counts, N.
    """
    return env.signals.body_force > force


@reads_bodies
def feet_too_close(env: Env, distance: NotNegative) -> Tensor:
    """Termination: the feet are almost in the same place.

    Args:
        distance: Horizontal distance below which it counts, m.
    """
    left, right = (env.bodies.position(name)[:, :2] for name in env.robot.foot_bodies)
    return (left - right).norm(dim=1) < distance


def not_moving(env: Env, distance: NotNegative, seconds: Positive) -> Tensor:
    """Termination: some time after its start the robot is still close to where it began.

    Args:
        distance: Horizontal distance from the start below which it counts, m.
        seconds: Time after the start, s; it is looked at once.
    """
    away = (env.signals.root_pos_w - env.start_root_pos_w)[:, :2].norm(dim=1)
    return (env.steps_since_reset == round(seconds / env.step_dt)) & (away < distance)
