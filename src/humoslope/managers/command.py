"""The velocity command: the task given to the policy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import accumulate
from typing import TYPE_CHECKING, Annotated

import torch
from rich.table import Table
from torch import Tensor

from humoslope.errors import UserError, unknown
from humoslope.managers.clock import check_interval
from humoslope.ranges import NotNegative, PositiveSpan, Range, Share, check_config
from humoslope.strict import StrictCfg

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


MODES = ("forward", "backward", "sideways", "turning")
"""Sorts of commands to move. On tiles that are walked along x all are forward."""
SKILLS = (*MODES, "standing")
"""Sorts of commands."""


@dataclass
class VelocityCommandCfg(StrictCfg):
    """Speed along the ground in the heading frame, and yaw rate.

    An env that steers turns to its heading target: the direction of travel (+x) on a tile that is walked along x, and
    on a tile that is walked in any direction the heading that it had when its command was drawn.

    Attributes:
        speed: Lowest and highest forward speed, m/s.
        lateral: Lowest and highest speed to the left, m/s.
        yaw_rate: Lowest and highest yaw rate of the envs without a heading target, rad/s.
        heading_share: Share of envs that steer to a heading target by `heading_gain`.
        heading_gain: Yaw rate per heading error, 1/s.
        lateral_gain: Heading error added per metre off the centre line of a tile that is walked along x, rad/m, so that
            the path stays on the tile.
        yaw_rate_limit: Highest yaw rate commanded by steering, rad/s.
        standing_share: Share of envs that are commanded to stand.
        resample_s: Shortest and longest duration of a command, s.
        modes: Shares of forward, backward, sideways and turning (in place) among the commands to move on tiles that are
            walked in any direction. Shares need not sum to one. Empty for forward alone, as on all other tiles.
        backward: Lowest and highest speed of the mode backward, m/s.
        sideways: Lowest and highest speed of the mode sideways, to the left or to the right, m/s.
        turning: Lowest and highest yaw rate of the mode turning, to the left or to the right, rad/s.
    """

    speed: Annotated[tuple[float, float], Range(-10.0, 10.0)] = (0.3, 0.8)
    lateral: Annotated[tuple[float, float], Range(-10.0, 10.0)] = (0.0, 0.0)
    yaw_rate: Annotated[tuple[float, float], Range(-20.0, 20.0)] = (-0.3, 0.3)
    heading_share: Share = 0.8
    heading_gain: NotNegative = 0.5
    lateral_gain: NotNegative = 0.3
    yaw_rate_limit: Annotated[float, Range(0.0, 20.0)] = 0.3
    standing_share: Share = 0.05
    resample_s: PositiveSpan = (8.0, 12.0)
    modes: Mapping[str, NotNegative] = field(default_factory=dict)
    backward: Annotated[tuple[float, float], Range(0.0, 10.0)] = (0.1, 0.4)
    sideways: Annotated[tuple[float, float], Range(0.0, 10.0)] = (0.1, 0.4)
    turning: Annotated[tuple[float, float], Range(0.0, 20.0)] = (0.2, 0.8)

    def build(self, env: Env) -> CommandManager:
        """Creates the manager of these commands."""
        return CommandManager(env, self)

    def on_course(self, asked: VelocityCommandCfg) -> VelocityCommandCfg:
        """The command of an evaluation that asks for a velocity, in the form that this task's policies understand."""
        return asked

    def asks_for(self, mode: str) -> bool:
        """True if commands of this mode are drawn."""
        return self.modes.get(mode, 0.0) > 0.0 if self.modes else mode == "forward"

    def bounds(self) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
        """Lowest and highest forward speed and speed to the left, m/s, and yaw rate, rad/s, of commands to move."""
        forward, left, turn = self.speed, self.lateral, self.yaw_rate
        if self.heading_share > 0.0:
            turn = _widened(turn, self.yaw_rate_limit)
        if self.asks_for("backward"):
            forward = (min(forward[0], -self.backward[1]), forward[1])
        if self.asks_for("sideways"):
            left = _widened(left, self.sideways[1])
        if self.asks_for("turning"):
            turn = _widened(turn, self.turning[1])
        return forward, left, turn


def _widened(span: tuple[float, float], bound: float) -> tuple[float, float]:
    """The span, widened to +-`bound`."""
    return min(span[0], -bound), max(span[1], bound)


class CommandManager:
    """Draws commands and steers the envs that hold a heading.

    Attributes:
        velocity: [N, 3] commanded velocity: forward and left in m/s along the ground, yaw rate in rad/s.
        variety: [4] how far commands of each of `SKILLS` but forward have moved from forward ones, in [0, 1], for
            curricula; 1 at first. Commands backward and sideways point this share of the way round from ahead, and
            commands to turn lie at this share of the way from a forward one; this share of those to stand is kept.
    """

    def __init__(self, env: Env, cfg: VelocityCommandCfg) -> None:
        check_config("command", cfg)
        _check_modes(cfg, env.tiles.has_omnidirectional)
        steps = check_interval("command: resample_s", cfg.resample_s, env.step_dt)
        self._env, self.cfg = env, cfg
        self.velocity = env.zeros(3)
        self._yaw_rate = env.zeros()  # [N] rad/s, of the envs without a heading target
        self._steers = env.zeros(dtype=torch.bool)  # [N]
        self._heading = env.zeros()  # [N] rad, the target on tiles that are walked in any direction
        self._stands = env.zeros(dtype=torch.bool)  # [N]
        self._mode = env.zeros(dtype=torch.int64)  # [N] in MODES, of the latest command to move
        self.variety = torch.ones(len(SKILLS) - 1, device=env.device)
        self._steps_left = env.zeros()  # [N] control steps until the next draw, whole numbers
        ranges = torch.tensor([cfg.speed, cfg.lateral, cfg.yaw_rate, steps], device=env.device)
        self._low, self._high = ranges.unbind(dim=1)  # [4]
        ends = list(accumulate(cfg.modes.get(mode, 0.0) for mode in MODES))
        self._mode_ends = torch.tensor([end / (ends[-1] or 1.0) for end in ends], device=env.device)  # [4]
        sizes = torch.tensor([cfg.backward, cfg.sideways, cfg.turning], device=env.device)
        self._least, self._most = sizes.unbind(dim=1)  # [3] m/s, m/s, rad/s

    @property
    def moving(self) -> Tensor:
        """The envs [N] that are commanded to move."""
        return ~self._stands

    @property
    def skill(self) -> Tensor:
        """What each env is commanded to do, [N] int64, as a place in `SKILLS`."""
        return torch.where(self.moving, self._mode, SKILLS.index("standing"))

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
        steers = random[:, 5] < self.cfg.heading_share
        velocity = drawn[:, :3]
        if self.cfg.modes:
            mode, velocity, steers = self._in_modes(velocity, steers)
            self._mode = torch.where(mask, mode, self._mode)
        self._stands = torch.where(mask, random[:, 4] < self.cfg.standing_share * self.variety[3], self._stands)
        self._steers = torch.where(mask, steers, self._steers)
        self._yaw_rate = torch.where(mask, velocity[:, 2], self._yaw_rate)
        self._heading = torch.where(mask, self._env.signals.heading_w, self._heading)
        self._steps_left = torch.where(mask, drawn[:, 3].round().clamp(min=1.0), self._steps_left)
        linear = torch.where(mask[:, None], velocity[:, :2], self.velocity[:, :2])
        return linear.masked_fill(self._stands[:, None], 0.0)

    def _in_modes(self, velocity: Tensor, steers: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Draws a mode for each env; forward commands, those on tiles walked along x among them, stay as they are.
        Returns mode, velocity and whether the env steers.

        Args:
            velocity: [N, 3] drawn as a forward command.
            steers: [N] bool.
        """
        random = torch.rand(self._env.num_envs, 3, device=self._env.device)
        mode = (random[:, :1] >= self._mode_ends[:-1]).sum(dim=1) * self._env.tiles.omnidirectional  # [N] in MODES
        backward, sideways, turning = (mode == MODES.index(name) for name in MODES[1:])
        size = torch.lerp(self._least, self._most, random[:, 1:2])  # [N, 3]
        side = torch.where(random[:, 2] < 0.5, -1.0, 1.0)
        yaw_rate = torch.where(turning, side * size[:, 2], velocity[:, 2])
        # Not straight from ahead to back: halfway, a command to move would be one to stand, and be obeyed for good.
        speed = torch.lerp(velocity[:, :1], size[:, :2], self.variety[:2])  # [N, 2] of backward and of sideways
        to_back, to_side = (
            torch.pi * (1.0 - self.variety[0]),
            0.5 * torch.pi * (1.0 - self.variety[1]),
        )  # rad, still to go
        back, aside = speed[:, 0] * backward, speed[:, 1] * sideways
        ahead = to_side.sin() * aside - to_back.cos() * back
        left = side * (to_side.cos() * aside + to_back.sin() * back)
        turn = self.variety[2]
        linear = torch.stack([ahead, left], dim=1) + (1.0 - turn) * velocity[:, :2] * turning[:, None]
        other = torch.cat([linear, torch.lerp(velocity[:, 2], yaw_rate, turn)[:, None]], dim=1)
        return mode, torch.where((mode > 0)[:, None], other, velocity), steers & ~turning

    def _steer(self, linear: Tensor) -> None:
        self.velocity = torch.cat([linear, self._turn()[:, None]], dim=1)

    def _turn(self) -> Tensor:
        """Commanded yaw rate [N], rad/s."""
        cfg, signals = self.cfg, self._env.signals
        target = -cfg.lateral_gain * (signals.root_pos_w[:, 1] - self._env.tiles.origin_w[:, 1])
        if self._env.tiles.has_omnidirectional:
            target = torch.where(self._env.tiles.omnidirectional, self._heading, target)
        error = torch.remainder(target - signals.heading_w + torch.pi, 2 * torch.pi) - torch.pi
        steered = (cfg.heading_gain * error).clamp(-cfg.yaw_rate_limit, cfg.yaw_rate_limit)
        return torch.where(self._steers, steered, self._yaw_rate).masked_fill(self._stands, 0.0)

    def table(self) -> Table:
        """Table of the ranges and shares of commands."""
        table = Table("command", "value", title="Commands")
        for name, value in vars(self.cfg).items():
            table.add_row(name, str(value))
        return table


def commanded_and_walked(env: Env) -> tuple[Tensor, Tensor]:
    """Commanded speed along the ground, whatever its direction, and speed of the root in that direction; [N] each, m/s.

    Both are zero in envs that are commanded to stand or to turn in place.
    """
    command = env.commands.velocity[:, :2]  # [N, 2] forward and left
    speed = command.norm(dim=1)
    along = (env.signals.root_lin_vel_t[:, :2] * command).sum(dim=1)
    return speed, along / speed.clamp(min=1e-6)


def _check_modes(cfg: VelocityCommandCfg, has_omnidirectional: bool) -> None:
    """Checks the fields that belong to modes.

    Raises:
        UserError: If one is impossible, or there is no ground for a mode.
    """
    for name in cfg.modes:
        if name not in MODES:
            raise unknown("command mode", name, MODES)
    if cfg.modes and sum(cfg.modes.values()) <= 0.0:
        raise UserError("command: the shares of modes sum to 0; give at least one mode a share above 0.")
    aside = [name for name in MODES[1:] if cfg.asks_for(name)]
    if aside and not has_omnidirectional:
        raise UserError(
            f"command: mode '{aside[0]}' has a share, but every tile is walked along x; give the terrain a kind that "
            "is walked in any direction, such as 'hillside'."
        )
