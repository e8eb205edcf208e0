"""Actions: joint position targets around the default pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from rich.table import Table
from torch import Tensor

from humoslope.errors import UserError
from humoslope.strict import StrictCfg

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


@dataclass
class JointPositionActionCfg(StrictCfg):
    """Target of every joint: default pose + `scale_factor` x the robot's action scale x action.

    Actions are not clipped: with the gains of a low-impedance drive, peak torque needs actions of 3 and more.
    """

    scale_factor: float = 1.0


class ActionManager:
    """Turns actions into controls and remembers the last two."""

    def __init__(self, env: Env, cfg: JointPositionActionCfg) -> None:
        robot = env.robot
        if cfg.scale_factor <= 0.0:
            raise UserError(f"actions: scale_factor {cfg.scale_factor} must be positive.")
        self._ctrl = env.sim.state("ctrl")  # [N, J]
        self._default = torch.tensor(robot.default_joint_pos, device=env.device)  # [J]
        self._scale = torch.tensor(robot.action_scale, device=env.device) * cfg.scale_factor  # [J]
        self._robot = robot
        self.action = env.zeros(robot.num_joints)  # [N, J] a_t
        self.previous_action = env.zeros(robot.num_joints)  # [N, J] a_(t-1)

    def process(self, action: Tensor) -> None:
        """Takes the policy's action [N, J] and holds its joint targets for the step."""
        self.previous_action = self.action
        # The learner owns the tensor it gave. A diverged policy must not write NaN into the physics.
        self.action = torch.nan_to_num(action, nan=0.0, posinf=100.0, neginf=-100.0)
        self._ctrl.copy_(self._default + self._scale * self.action)

    def reset(self, mask: Tensor) -> None:
        """Forgets the actions of the worlds in `mask`."""
        self.action = self.action.masked_fill(mask[:, None], 0.0)
        self.previous_action = self.previous_action.masked_fill(mask[:, None], 0.0)
        self._ctrl.copy_(torch.where(mask[:, None], self._default.to(self._ctrl.dtype), self._ctrl))

    def table(self) -> Table:
        """Which joints move, how far per unit of action, and how stiff they are."""
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
