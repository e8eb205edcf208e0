"""Writes down what happens in the first world of an environment, step by step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from humoslope.managers.terms import StatefulTerm
from humoslope.mdp import events
from humoslope.mdp.bsga import ComHeight
from humoslope.mdp.zmp import ZmpRegulariser
from humoslope.replay.rollout import Columns
from humoslope.slope import quaternion

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

SIGNALS = (
    "root_pos_w",
    "root_quat_w",
    "root_lin_vel_w",
    "root_ang_vel_b",
    "root_lin_vel_t",
    "root_height",
    "joint_pos",
    "joint_vel",
    "joint_torque",
    "com_pos_w",
    "com_lin_vel_w",
    "com_height",
    "foot_pos_w",
    "foot_force_w",
)
"""Columns that are signals of the same name."""


class Recorder(StatefulTerm):
    """Step event that keeps a row of every column.

    Step events run after rewards and terminations and before resets, so that a fall is seen as it is.

    Args:
        regulariser: Parameters of the `ZmpRegulariser` whose anchor, plane and point are recorded.
        com_height: Parameters of the `ComHeight` whose target is recorded; None where the task has no target.

    Attributes:
        ended: Whether the robot left its ground in the last step.
        fell: Whether it fell.
    """

    def __init__(self, env: Env, regulariser: dict[str, Any], com_height: dict[str, Any] | None = None) -> None:
        self._zmp = ZmpRegulariser(env, **regulariser)
        self._com_height = None if com_height is None else ComHeight(env, **com_height)
        self._rows: list[dict[str, Tensor]] = []
        self._episode = 0
        self.ended = self.fell = False

    def __call__(self, env: Env, mask: Tensor) -> None:
        signals, ground = env.signals, env.height_scan.descriptor
        self._zmp(env)
        row = {name: getattr(signals, name) for name in SIGNALS} | {
            "action": env.actions.action,
            "command": env.commands.velocity,
            "com_height_target": self._vertical_target(env),
            "reward": env.rewards.last,
            "slope": ground.slope,
            "bank": ground.bank,
            "ground_normal_w": quaternion.rotate(quaternion.from_yaw(signals.heading_w), ground.normal),
            "uphill": ground.up,
            "downhill": ground.down,
            "zmp_anchor_w": self._zmp.anchor,
            "zmp_normal_w": self._zmp.normal,
            "zmp_w": self._zmp.point,
            "zmp_valid": self._zmp.valid,
        }
        self._rows.append({name: value[0].cpu().clone() for name, value in row.items()})
        self._rows[-1]["episode"] = torch.tensor(self._episode, dtype=torch.int32)
        self.fell = bool(env.terminations.terminated[0] | env.diverged[0])
        self.ended = bool(env.terminations.time_outs[0]) and not self.fell
        self._episode += self.fell

    @property
    def steps(self) -> int:
        """Rows so far."""
        return len(self._rows)

    def _vertical_target(self, env: Env) -> Tensor:
        """Height of the centre of mass above the ground below it that the task asks for, [N] m."""
        if self._com_height is None:
            return torch.full_like(env.signals.com_height, torch.nan)
        # What lies at right angles to the slope is further off vertically.
        return self._com_height.target(env) / env.height_scan.descriptor.slope.cos()

    def reset(self, mask: Tensor) -> None:
        """The support plane of the last episode is forgotten; the rows stay."""
        self._zmp.reset(mask)

    def columns(self, dt: float) -> Columns:
        """All rows, `dt` seconds apart."""
        rows = self._rows
        arrays = {name: torch.stack([row[name] for row in rows]).numpy() for name in rows[0]}
        return Columns(time=(np.arange(1, len(rows) + 1) * dt).astype(np.float32), **arrays)


class Pushes(StatefulTerm):
    """Interval event: `events.push`, remembered. There must be a `Recorder` called "recorder".

    Args:
        speed: See `events.push`.

    Attributes:
        kicks: (recorded steps before it, change of the root's velocity in m/s along world x and y).
    """

    def __init__(self, env: Env, speed: float) -> None:
        self._speed = speed
        self.kicks: list[tuple[int, float, float]] = []

    def __call__(self, env: Env, mask: Tensor) -> None:
        qvel = env.sim.state("qvel")
        before = qvel[0, :2].clone()
        events.push(env, mask, self._speed)
        if mask[0]:
            x, y = (qvel[0, :2] - before).tolist()
            self.kicks.append((env.events["recorder"].steps, x, y))

    def reset(self, mask: Tensor) -> None:
        """What was remembered stays."""
