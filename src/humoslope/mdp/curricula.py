"""Curricula of the ground."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from humoslope.errors import UserError, require_not_negative, require_positive
from humoslope.managers.command import commanded_and_walked
from humoslope.managers.curriculum import CurriculumTerm
from humoslope.mdp.harness import Harness
from humoslope.ranges import NotNegative, Positive, Share

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


class TerrainLevels(CurriculumTerm):
    """An env moves to a harder tile after covering the better part of its own, and to an easier one after failing.

    On a tile that is walked along x, up: `up` of the way from the start of the episode to the end of the tile was
    covered; down: otherwise, after a fall. On a tile that is walked in any direction, where no such way exists, up: the
    robot walked `up` of what was commanded, for `least_s` or longer, and did not fall; down: after a fall within
    `least_s`. A robot that stands or turns in place as commanded, and does not fall, has done all that was asked. On
    both, down too: the robot walked less than `down` of the distance that was commanded. The commanded distance, and
    what was walked of it, are summed over the episode: the commanded speed along the ground in whatever direction, and
    the root's speed in that direction. From the hardest level an env moves to a random one, so that the easy ones are
    not forgotten.

    Args:
        up: Share of the way to the end of the tile, or of the commanded distance on a tile walked in any direction.
            Ours: asked for more, which is about what a policy walks while it learns, robots hardly ever rise.
        down: Share of the commanded distance.
        least_commanded: Commanded distance below which only a fall costs a level, m. Ours: what little a robot drifts
            while it stands, or in an episode that was cut short, is no failure.
        least_s: Shortest time by which a level is earned, and longest after which a fall costs one, on a tile walked in
            any direction, s. Ours: such a robot may start close to the edge and walk off it.
        harness: Name of the `Harness` event: levels open as its strictness grows, the first one alone before. Empty for
            no such limit. Open from the start, steep levels fell robots at the same rate however well they walk,
            and the harness stays.
        spread: Share of the levels over which envs are spread at random at first, from the easiest: 0 for the easiest
            alone, 1 for a policy that can walk them all already.
    """

    START_ONLY = ("spread",)

    def __init__(
        self,
        env: Env,
        up: Share = 0.5,
        down: Share = 0.25,
        least_commanded: NotNegative = 1.0,
        harness: str = "",
        spread: Share = 0.0,
        least_s: Positive = 5.0,
    ) -> None:
        if not 0.0 < down < up <= 1.0:
            raise UserError(f"terrain levels: down {down:g} and up {up:g} must be shares with 0 < down < up <= 1.")
        if not 0.0 <= spread <= 1.0:
            raise UserError(f"terrain levels: spread {spread:g} must be between 0 and 1.")
        require_not_negative("terrain levels", least_commanded=least_commanded)
        require_positive("terrain levels", least_s=least_s)
        env.tiles.set_level(torch.randint_like(env.tiles.level, max(1, round(spread * env.tiles.num_levels))))
        self._env, self._up, self._down, self._least = env, up, down, least_commanded
        self._least_steps = least_s / env.step_dt
        self._harness = Harness.of(env, harness) if harness else None
        self._commanded = env.zeros()  # [N] m since the start of the episode
        self._walked = env.zeros()  # [N] m in the commanded direction

    def step(self, env: Env) -> Tensor:
        """Adds up what was commanded and walked; returns the levels."""
        commanded, walked = commanded_and_walked(env)
        self._commanded = torch.add(self._commanded, commanded, alpha=env.step_dt)
        self._walked = torch.add(self._walked, walked, alpha=env.step_dt)
        return env.tiles.level

    def reset(self, mask: Tensor) -> None:
        """Moves the envs in `mask` [N] to their next level."""
        env, tiles = self._env, self._env.tiles
        start = env.start_root_pos_w[:, 0]
        covered = env.signals.root_pos_w[:, 0] - start
        fell = env.terminations.terminated
        rise = covered >= self._up * (tiles.origin_w[:, 0] + tiles.length - start)
        if tiles.has_omnidirectional:
            late = env.steps_since_reset >= self._least_steps
            followed = self._walked >= self._up * self._commanded
            rise = torch.where(tiles.omnidirectional, late & followed & ~fell, rise)
            fell = fell & ~(tiles.omnidirectional & late)
        lazy = (self._walked < self._down * self._commanded) & (self._commanded >= self._least)
        sink = ~rise & (fell | lazy)
        judged = mask & ~env.diverged  # the place of a robot whose physics failed has no meaning
        level = tiles.level + (judged & rise).to(torch.int64) - (judged & sink).to(torch.int64)
        anywhere = torch.randint_like(level, tiles.num_levels)
        level = torch.where(level >= tiles.num_levels, anywhere, level).clamp(min=0)
        if self._harness is not None:
            open_levels = (self._harness.strictness * tiles.num_levels).floor().to(torch.int64)
            level = torch.minimum(level, open_levels)
        tiles.set_level(torch.where(mask, level.clamp(max=tiles.num_levels - 1), tiles.level))
        self._commanded = self._commanded.masked_fill(mask, 0.0)
        self._walked = self._walked.masked_fill(mask, 0.0)
