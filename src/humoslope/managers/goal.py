"""The goal command: a place to be at in some seconds, instead of a velocity."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, ClassVar

import torch
from torch import Tensor

from humoslope.errors import UserError
from humoslope.managers.clock import control_steps
from humoslope.managers.command import CommandManager, VelocityCommandCfg
from humoslope.ranges import NotNegative, Positive, Range, Share, check_config

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

PASSED = 0.5
"""Distance at which an evaluation's goal makes room for the next one, m: the robot has not begun to stop yet. Ours."""


@dataclass
class GoalCommandCfg(VelocityCommandCfg):
    """A goal to be reached within a time, after which there is another one.

    A goal lies as far away as `speed` goes in the time before the last `stay_s`: 4 m at 0.5 m/s. On a tile that is
    walked along x it is ahead on the centre line (beside it, with `lateral_gain` 0); on a tile that is walked in any
    direction it is in a random direction. It is never closer than `edge` to the edges of the tile.

    What counts commands and what was walked of them reads a velocity: `speed` in the direction of the goal, and the yaw
    rate that steers there; zero at the goal. The policy does not see it. On a tile that is walked along x it is the one
    that a `VelocityCommandCfg` of the same values would ask for.

    A goal always steers, and has no modes; `resample_s` has no meaning.

    Attributes:
        time_s: Time for a goal, s; then there is another one.
        stay_s: Last part of that time, in which the robot should be there already, s.
        reach: Distance at which a goal is reached, m.
        pass_at: Distance at which a goal makes room for the next one before its time is over, m; 0 to stand at each.
            A goal that a robot was asked to stand at stays for its time.
        edge: Least distance of a goal from the edges of the tile, m.
    """

    speed: Annotated[tuple[float, float], Range(-10.0, 10.0)] = (0.5, 0.5)
    heading_share: Share = 1.0
    standing_share: Share = 0.0
    time_s: Positive = 10.0
    stay_s: NotNegative = 2.0
    reach: Positive = 0.2
    pass_at: NotNegative = 0.0
    edge: NotNegative = 1.0

    reads_bodies: ClassVar[bool] = True

    def build(self, env: Env) -> GoalCommand:
        """Creates the manager of these goals."""
        return GoalCommand(env, self)

    def on_course(self, asked: VelocityCommandCfg) -> GoalCommandCfg:
        """Goals for an evaluation that asks for a velocity along a course.

        The goal is always ahead on the course's centre line, where the asked speed leads in `time_s - stay_s`, at most
        at the course's end; a new one is set, and its time begins anew, once the robot is `PASSED` close, since the
        course asks for walking, not for standing at goals.
        """
        same = {field.name: getattr(asked, field.name) for field in fields(VelocityCommandCfg)}
        own = {name: getattr(self, name) for name in ("time_s", "stay_s", "reach", "edge")}
        return GoalCommandCfg(**same, **own, pass_at=PASSED)


class GoalCommand(CommandManager):
    """Sets goals and measures the way to them.

    Attributes:
        goal_w: [N, 2] place of the goal, m.
    """

    cfg: GoalCommandCfg

    def __init__(self, env: Env, cfg: GoalCommandCfg) -> None:
        check_config("command", cfg)
        super().__init__(env, cfg)
        if cfg.modes:
            raise UserError("command: goals have no modes; leave modes empty.")
        if cfg.heading_share < 1.0 and cfg.standing_share < 1.0:
            raise UserError(
                f"command: heading_share is {cfg.heading_share:g}; a goal always steers and cannot ask for a yaw rate, "
                "so it must be 1."
            )
        if cfg.stay_s >= cfg.time_s:
            raise UserError(f"command: stay_s {cfg.stay_s:g} must be less than time_s {cfg.time_s:g}.")
        tiles = env.tiles
        if 2.0 * cfg.edge >= min(tiles.length, tiles.width):
            raise UserError(
                f"command: edge {cfg.edge:g} leaves no room for goals on a tile of {tiles.length:g} x "
                f"{tiles.width:g} m."
            )
        self._steps = control_steps("command: time_s", cfg.time_s, env.step_dt)
        corners = [[cfg.edge, cfg.edge - 0.5 * tiles.width], [tiles.length - cfg.edge, 0.5 * tiles.width - cfg.edge]]
        self._corners = torch.tensor(corners, device=env.device)  # [2, 2] m from the tile's start
        self.goal_w = env.zeros(2)
        self._asked = env.zeros(2)  # [N, 2] m/s, forward and left on the course
        self._asked_to_stand = env.zeros(dtype=torch.bool)
        self._since = env.zeros(dtype=torch.int64)  # [N] control step of the episode at which the goal was set
        self._steers = torch.ones_like(self._asked_to_stand)

    @property
    def to_goal_w(self) -> Tensor:
        """[N, 2] horizontal way from the root to the goal, m."""
        return self.goal_w - self._env.signals.root_pos_w[:, :2]

    @property
    def reached(self) -> Tensor:
        """[N] bool; the envs whose robot is at its goal."""
        return self.to_goal_w.norm(dim=1) < self.cfg.reach

    @property
    def elapsed_s(self) -> Tensor:
        """[N] time since the goal was set, s."""
        return (self._env.steps_since_reset - self._since) * self._env.step_dt

    @property
    def left_s(self) -> Tensor:
        """[N] time until the goal's is over, s."""
        return self.cfg.time_s - self.elapsed_s

    def reset(self, mask: Tensor) -> None:
        """Sets a goal for the envs in `mask` [N], whose episodes begin."""
        self._set_goals(mask)
        self._since = self._since.masked_fill(mask, 0)
        self._ask()

    def step(self) -> None:
        """Lets a control step pass: another goal where the time is over or the robot has come close."""
        steps = self._env.steps_since_reset
        # A goal to stand at is there from the start, and stays: it would follow a robot that creeps away otherwise.
        passed = (self.to_goal_w.norm(dim=1) < self.cfg.pass_at) & ~self._asked_to_stand
        over = (steps - self._since >= self._steps) | passed
        if not self._env.sim.known_empty(over):
            self._set_goals(over)
            self._since = torch.where(over, steps, self._since)
        self._ask()

    def _set_goals(self, mask: Tensor) -> None:
        """Draws goals for the envs in `mask` [N]."""
        cfg, tiles = self.cfg, self._env.tiles
        random = torch.rand(self._env.num_envs, 4, device=self._env.device)
        asked = torch.lerp(self._low[:2], self._high[:2], random[:, :2])
        stands = random[:, 2] < cfg.standing_share * self.variety[3]
        place, start = self._env.signals.root_pos_w[:, :2], tiles.origin_w[:, :2]
        way = asked * (cfg.time_s - cfg.stay_s)
        line = start[:, 1] if cfg.lateral_gain > 0.0 else place[:, 1]
        goal = torch.stack([place[:, 0] + way[:, 0], line + way[:, 1]], dim=1)
        if tiles.has_omnidirectional:
            bearing = 2.0 * torch.pi * random[:, 3:]
            aside = torch.cat([-way[:, 1:], way[:, :1]], dim=1)  # the way, turned to the left by a right angle
            anywhere = place + way * bearing.cos() + aside * bearing.sin()
            goal = torch.where(tiles.omnidirectional[:, None], anywhere, goal)
        goal = torch.minimum(torch.maximum(goal, start + self._corners[0]), start + self._corners[1])
        goal = torch.where(stands[:, None], place, goal)
        self.goal_w = torch.where(mask[:, None], goal, self.goal_w)
        self._asked = torch.where(mask[:, None], asked, self._asked)
        self._asked_to_stand = torch.where(mask, stands, self._asked_to_stand)

    def _ask(self) -> None:
        """Sets the velocity that leads to the goal."""
        tiles, to_goal = self._env.tiles, self.to_goal_w
        self._stands = self._asked_to_stand | self.reached
        linear = self._asked
        if tiles.has_omnidirectional:
            self._heading = torch.atan2(to_goal[:, 1], to_goal[:, 0])
            off, speed = self._heading - self._env.signals.heading_w, linear.norm(dim=1)
            direct = torch.stack([speed * off.cos(), speed * off.sin()], dim=1)
            linear = torch.where(tiles.omnidirectional[:, None], direct, linear)
        self._steer(linear.masked_fill(self._stands[:, None], 0.0))
