"""Terms of Isaac Lab's velocity task for the G1 on rough ground that no other task here has; for baselines.

Source: Isaac Lab, `Isaac-Velocity-Rough-G1-v0` (`config/g1/rough_env_cfg.py` and the terms that it uses). None of its
terms refers to the world's origin.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from torch import Tensor

from humoslope.managers.terms import StatefulTerm
from humoslope.mdp.footfalls import TimeOnOneLeg
from humoslope.mdp.selection import Joints, joint_mask
from humoslope.ranges import NotNegative, Positive

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


def joint_torques_l2(env: Env, joints: Joints) -> Tensor:
    """Squared torques of some joints, summed, (Nm)^2.

    Args:
        joints: Regular expression on whole joint names.
    """
    return env.signals.joint_torque.square() @ joint_mask(env.robot, joints, env.device)


def upper_contact(env: Env, force: NotNegative) -> Tensor:
    """Termination: the ground presses on anything but feet and shins.

    Isaac Lab's is for contact of the torso alone; the ground force on trunk, thighs and arms is one signal here.

    Args:
        force: Force above which it counts, N.
    """
    return env.signals.upper_force > force
