"""Actions: joint position targets around the default pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import torch
from rich.table import Table
from torch import Tensor

from humoslope.ranges import Range, check_config
from humoslope.strict import StrictCfg

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


@dataclass
class JointPositionActionCfg(StrictCfg):
    """Joint position targets: default pose + `scale_factor` x the robot's action scale x action.

    Actions are not clipped: with low gains, peak torque needs actions of 3 and more.

    Attributes:
        scale_factor: Factor on the robot's action scale of every joint.
    """

    scale_factor: Annotated[float, Range(0.0, 1000.0, open_low=True)] = 1.0


class ActionManager:
    """Turns actions into controls and remembers the last two.

    Attributes:
        action: [N, J] action of this control step; zero at the start of an episode.
        previous_action: [N, J] action of the control step before.
        default_ctrl: [N, J] joint targets of a zero action, which hold at the start of an episode, rad.
    """

    def __init__(self, env: Env, cfg: JointPositionActionCfg) -> None:
        robot = env.robot
        check_config("actions", cfg)
        self._env = env
        self._ctrl = env.sim.state("ctrl")  # [N, J]
        self._default = torch.tensor(robot.default_joint_pos, device=env.device)  # [J]
        self._scale = torch.tensor(robot.action_scale, device=env.device) * cfg.scale_factor  # [J]
        self._robot = robot
        self._watched = env.finite.watch({"the action": robot.num_joints})
        self.default_ctrl = self._default.expand(env.num_envs, -1)
        self.action = env.zeros(robot.num_joints)
        self.previous_action = env.zeros(robot.num_joints)

    def process(self, action: Tensor) -> None:
        """Takes the policy's action [N, J] and sets its joint targets for the control step."""
        self._watched.add(action.detach(), self._env.finite.step)
        self.previous_action = self.action
        # A copy, since the learner owns the tensor. A diverged policy must not write NaN into the physics.
        self.action = torch.nan_to_num(action, nan=0.0, posinf=100.0, neginf=-100.0)
        self._ctrl.copy_(self._default + self._scale * self.action)

    def reset(self, mask: Tensor) -> None:
        """Sets the remembered actions of the envs in `mask` [N] to zero. The simulation's reset sets their controls."""
        self.action = self.action.masked_fill(mask[:, None], 0.0)
        self.previous_action = self.previous_action.masked_fill(mask[:, None], 0.0)

    def table(self) -> Table:
        """Table of the joints: default pose, action scale, gains and torque limit."""
        table = Table("joint", "default rad", "scale rad", "kp", "kd", "limit Nm", title="Actions")
        robot = self._robot
        rows = zip(
            robot.joint_names,
            self._default.tolist(),
            self._scale.tolist(),
            robot.stiffness,
            robot.damping,
            robot.effort_limit,
            strict=True,
        )
        for name, *numbers in rows:
            table.add_row(name, *(f"{x:.4g}" for x in numbers))
        return table
