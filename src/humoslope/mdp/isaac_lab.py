"""Terms of Isaac Lab's velocity task for the G1 on rough ground that no other task here has; for baselines.

Source: Isaac Lab, `Isaac-Velocity-Rough-G1-v0` (`config/g1/rough_env_cfg.py` and the terms that it uses). None of its
terms refers to the world's origin.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from torch import Tensor

from humoslope.managers.terms import StatefulTerm
from humoslope.mdp.footfalls import TimeOnOneLeg
from humoslope.mdp.rate import RateOfChange
from humoslope.mdp.selection import Joints, joint_mask
from humoslope.ranges import NotNegative, Positive, Range

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


class FeetAirTime(StatefulTerm):
    """Reward for time on one leg, s: the time since a foot last landed or lifted, the shorter one of the two feet.

    It is 0 unless exactly one foot is down, and in envs that are commanded to walk slower than `least_command`.

    Args:
        threshold: Time beyond which the reward grows no more, s.
        least_command: Commanded speed above which it counts, m/s.
    """

    def __init__(self, env: Env, threshold: Positive, least_command: NotNegative = 0.1) -> None:
        self._threshold, self._least = threshold, least_command
        self._time = TimeOnOneLeg(env)

    def __call__(self, env: Env) -> Tensor:
        asked = env.commands.velocity[:, :2].norm(dim=1) > self._least
        return self._time(env).clamp(max=self._threshold) * asked

    def reset(self, mask: Tensor) -> None:
        """Sets the times of the envs in `mask` to zero."""
        self._time.reset(mask)


class AccelerationOfJointsL2(StatefulTerm):
    """Squared accelerations of some joints over one control step, summed, (rad/s^2)^2.

    Args:
        joints: Regular expression on whole joint names.
    """

    def __init__(self, env: Env, joints: Joints) -> None:
        self._rate = RateOfChange(env.step_dt)
        self._mask = joint_mask(env.robot, joints, env.device)

    def __call__(self, env: Env) -> Tensor:
        return self._rate(env.signals.joint_vel).square() @ self._mask

    def reset(self, mask: Tensor) -> None:
        """Makes the next acceleration of the envs in `mask` zero."""
        self._rate.reset(mask)


def joint_torques_l2(env: Env, joints: Joints) -> Tensor:
    """Squared torques of some joints, summed, (Nm)^2.

    Args:
        joints: Regular expression on whole joint names.
    """
    return env.signals.joint_torque.square() @ joint_mask(env.robot, joints, env.device)


def limits_of_joints(env: Env, joints: Joints, soft: Annotated[float, Range(0.0, 1.0, open_low=True)]) -> Tensor:
    """Distance of some joints beyond the middle share of their range, summed, rad.

    Args:
        joints: Regular expression on whole joint names.
        soft: Middle share of the range of every joint within which there is no penalty.
    """
    low, high = env.joint_range.unbind(dim=1)
    margin = 0.5 * (1.0 - soft)
    pos = env.signals.joint_pos
    beyond = (low.lerp(high, margin) - pos).relu() + (pos - high.lerp(low, margin)).relu()
    return beyond @ joint_mask(env.robot, joints, env.device)


def upper_contact(env: Env, force: NotNegative) -> Tensor:
    """Termination: the ground presses on anything but feet and shins.

    Isaac Lab's is for contact of the torso alone; the ground force on trunk, thighs and arms is one signal here.

    Args:
        force: Force above which it counts, N.
    """
    return env.signals.upper_force > force
