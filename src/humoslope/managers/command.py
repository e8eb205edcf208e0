"""The velocity command: the task given to the policy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from rich.table import Table
from torch import Tensor

from humoslope.errors import UserError, require_not_negative
from humoslope.managers.clock import check_interval
from humoslope.strict import StrictCfg

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


@dataclass
class VelocityCommandCfg(StrictCfg):
    """Speed along the ground in the heading frame, and yaw rate.

    Attributes:
        speed: Lowest and highest forward speed, m/s.
        lateral: Lowest and highest speed to the left, m/s.
        yaw_rate: Lowest and highest yaw rate of the envs without a heading target, rad/s.
        heading_share: Share of envs that steer to the direction of travel (+x of their tile) by `heading_gain`.
        heading_gain: Yaw rate per heading error, 1/s.
        lateral_gain: Heading error added per metre off the tile's centre line, rad/m, so that the path stays on the
            tile.
        yaw_rate_limit: Highest yaw rate commanded by steering, rad/s.
        standing_share: Share of envs that are commanded to stand.
        resample_s: Shortest and longest duration of a command, s.
    """

    speed: tuple[float, float] = (0.3, 0.8)
    lateral: tuple[float, float] = (0.0, 0.0)
    yaw_rate: tuple[float, float] = (-0.3, 0.3)
    heading_share: float = 0.8
    heading_gain: float = 0.5
    lateral_gain: float = 0.3
    yaw_rate_limit: float = 0.3
    standing_share: float = 0.05
    resample_s: tuple[float, float] = (8.0, 12.0)


class CommandManager:
    """Draws commands and steers the envs that hold a heading.

    Attributes:
        velocity: [N, 3] commanded velocity: forward and left in m/s along the ground, yaw rate in rad/s.
    """

    def __init__(self, env: Env, cfg: VelocityCommandCfg) -> None:
        for name in ("speed", "lateral", "yaw_rate"):
            low, high = getattr(cfg, name)
            if not -math.inf < low <= high < math.inf:
                raise UserError(f"command: {name} ({low:g}, {high:g}) must be (lowest, highest).")
        for name in ("heading_share", "standing_share"):
            if not 0.0 <= getattr(cfg, name) <= 1.0:
                raise UserError(f"command: {name} {getattr(cfg, name)} must be between 0 and 1.")
        require_not_negative(
            "command",
            heading_gain=cfg.heading_gain,
            lateral_gain=cfg.lateral_gain,
            yaw_rate_limit=cfg.yaw_rate_limit,
        )
        steps = check_interval("command: resample_s", cfg.resample_s, env.step_dt)
        self._env, self.cfg = env, cfg
        self.velocity = env.zeros(3)
        self._yaw_rate = env.zeros()  # [N] rad/s, of the envs without a heading target
        self._steers = env.zeros(dtype=torch.bool)  # [N]
        self._stands = env.zeros(dtype=torch.bool)  # [N]
        self._steps_left = env.zeros()  # [N] control steps until the next draw, whole numbers
        ranges = torch.tensor([cfg.speed, cfg.lateral, cfg.yaw_rate, steps], device=env.device)
        self._low, self._high = ranges.unbind(dim=1)  # [4]

    @property
    def moving(self) -> Tensor:
        """The envs [N] that are commanded to move."""
        return ~self._stands

    def reset(self, mask: Tensor) -> None:
        """Draws new commands for the envs in `mask` [N]."""
        self._steer(self._draw(mask))

    def step(self) -> None:
        """Lets a control step pass: commands whose time is over are drawn again, the others steer on."""
        self._steps_left = self._steps_left - 1.0
        over = self._steps_left <= 0.0
        self._steer(self.velocity[:, :2] if self._env.sim.known_empty(over) else self._draw(over))

    def _draw(self, mask: Tensor) -> Tensor:
        """New linear velocities [N, 2] for the envs in `mask` [N], the present ones for the others."""
        random = torch.rand(self._env.num_envs, 6, device=self._env.device)
        drawn = torch.lerp(self._low, self._high, random[:, :4])  # [N, 4]
        self._stands = torch.where(mask, random[:, 4] < self.cfg.standing_share, self._stands)
        self._steers = torch.where(mask, random[:, 5] < self.cfg.heading_share, self._steers)
        self._yaw_rate = torch.where(mask, drawn[:, 2], self._yaw_rate)
        self._steps_left = torch.where(mask, drawn[:, 3].round().clamp(min=1.0), self._steps_left)
        linear = torch.where(mask[:, None], drawn[:, :2], self.velocity[:, :2])
        return linear.masked_fill(self._stands[:, None], 0.0)

    def _steer(self, linear: Tensor) -> None:
        self.velocity = torch.cat([linear, self._turn()[:, None]], dim=1)

    def _turn(self) -> Tensor:
        """Commanded yaw rate [N], rad/s."""
        cfg, signals = self.cfg, self._env.signals
        target = -cfg.lateral_gain * (signals.root_pos_w[:, 1] - self._env.tiles.origin_w[:, 1])
        error = torch.remainder(target - signals.heading_w + torch.pi, 2 * torch.pi) - torch.pi
        steered = (cfg.heading_gain * error).clamp(-cfg.yaw_rate_limit, cfg.yaw_rate_limit)
        return torch.where(self._steers, steered, self._yaw_rate).masked_fill(self._stands, 0.0)

    def table(self) -> Table:
        """Table of the ranges and shares of commands."""
        table = Table("command", "value", title="Commands")
        for name, value in vars(self.cfg).items():
            table.add_row(name, str(value))
        return table
