"""Recording of the first env of an environment, step by step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from humoslope.evaluation.moments import MomentReader
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
    "self_force",
)
"""Columns that are copies of the signal of the same name."""


class RolloutRecorder:
    """Observer of an environment that keeps a row of every column for the first env.

    Observers are called after rewards and terminations, and before events and resets: a fall is recorded as it is.

    Args:
        env: The environment; the recorder adds itself to its observers.
        regulariser: Parameters of the `ZmpRegulariser` whose anchor, plane and point are recorded.
        com_height: Parameters of the `ComHeight` whose target is recorded; None if the task has no target.

    Attributes:
        fell: True if the robot fell in the last step.
        ended: True if the robot left its ground in the last step.
        pushes: Changes of the root's velocity that events made: (time in s, along world x and along world y in m/s).
        moments: `SIGNALS` [S] of every step.
    """

    def __init__(self, env: Env, regulariser: dict[str, Any], com_height: dict[str, Any] | None = None) -> None:
        self._zmp = ZmpRegulariser(env, **regulariser)
        self._com_height = None if com_height is None else ComHeight(env, **com_height)
        self._read_moment = MomentReader(env)
        self._qvel = env.sim.state("qvel")
        self._rows: list[dict[str, Tensor]] = []
        self._episode, self._dt = 0, env.step_dt
        self.ended = self.fell = False
        self.pushes: list[tuple[float, float, float]] = []
        self.moments: list[NDArray[np.float32]] = []
        env.observers.append(self)

    def __call__(self, env: Env) -> None:
        signals, ground = env.signals, env.height_scan.descriptor
        self._zmp(env)
        row = {name: getattr(signals, name) for name in SIGNALS} | {
            "action": env.actions.action,
            "command": env.commands.velocity,
            "com_height_target": self._vertical_target(env),
            "reward": env.rewards.last if env.rewards.names else env.zeros(0),
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
        self.moments.append(self._read_moment(env)[0].cpu().numpy())
        self._rows[-1]["episode"] = torch.tensor(self._episode, dtype=torch.int32)
        failed = env.terminations.terminated | env.diverged
        self.fell = bool(failed[0])
        self.ended = bool(env.terminations.time_outs[0]) and not self.fell
        self._episode += self.fell
        self._zmp.reset(failed | env.terminations.time_outs)
        self._before = self._qvel[0, :2].clone()

    def after_step(self) -> None:
        """Records what events did to the root's velocity. To be called after `env.step`.

        Only events act between an observer and the end of a step, unless the episode has ended.
        """
        x, y = (self._qvel[0, :2] - self._before).tolist()
        if (x or y) and not (self.fell or self.ended):
            self.pushes.append((len(self._rows) * self._dt, x, y))

    def _vertical_target(self, env: Env) -> Tensor:
        """Height of the centre of mass above the ground below it that the task asks for, [N] m."""
        if self._com_height is None:
            return torch.full_like(env.signals.com_height, torch.nan)
        # The target is perpendicular to the slope; measured vertically it is longer.
        return self._com_height.target(env) / env.height_scan.descriptor.slope.cos()

    def columns(self) -> Columns:
        """Returns all rows."""
        rows = self._rows
        arrays = {name: torch.stack([row[name] for row in rows]).numpy() for name in rows[0]}
        return Columns(time=(np.arange(1, len(rows) + 1) * self._dt).astype(np.float32), **arrays)
