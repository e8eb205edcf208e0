"""What gets harder on the ground."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from humoslope.errors import UserError
from humoslope.managers.terms import StatefulTerm
from humoslope.mdp.harness import HarnessCurriculum

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


class TerrainLevels(StatefulTerm):
    """A world moves to a steeper tile after covering most of its own, and to an easier one after failing.

    Up: `up` of the tile covered. Down: otherwise, a fall, or less than `down` of the distance that was commanded.
    From the hardest level a world moves to a random one, so that the easy ones are not forgotten.

    Args:
        up: Share of the tile's length.
        down: Share of the commanded distance.
        harness: Name of the harness curriculum: levels open as it is withdrawn. Empty for no such limit.
        spread: Share of the levels that worlds start on at random, from the easiest; 0 for the easiest alone, 1 for a
            policy that can walk them all already.
    """

    def __init__(self, env: Env, up: float = 0.8, down: float = 0.4, harness: str = "", spread: float = 0.0) -> None:
        if not 0.0 < down < up <= 1.0:
            raise UserError(f"terrain levels: down {down:g} and up {up:g} must be shares with 0 < down < up <= 1.")
        if not 0.0 <= spread <= 1.0:
            raise UserError(f"terrain levels: spread {spread:g} must be between 0 and 1.")
        env.tiles.set_level(torch.randint_like(env.tiles.level, max(1, round(spread * env.tiles.num_levels))))
        self._up, self._down = up, down
        self._harness: HarnessCurriculum | None = env.curriculum[harness] if harness else None
        self._asked = env.zeros()  # [N] m commanded since the start of the episode

    def __call__(self, env: Env, mask: Tensor) -> Tensor:
        tiles = env.tiles
        # Along the tile: a world that is asked to turn away from it is not asked to cover it.
        self._asked = self._asked + env.commands.velocity[:, 0] * env.signals.heading_w.cos() * env.step_dt
        if env.sim.known_empty(mask):
            return tiles.level
        end = tiles.length - tiles.spawn_x  # what there is to cover, from the spawn place
        covered = env.signals.root_pos_w[:, 0] - tiles.origin_w[:, 0] - tiles.spawn_x
        rise = covered >= self._up * end
        sink = ~rise & (env.terminations.terminated | (covered < self._down * self._asked))
        ended = mask & ~env.diverged  # where physics that went wrong has put a robot says nothing
        level = tiles.level + (ended & rise).to(torch.int64) - (ended & sink).to(torch.int64)
        anywhere = torch.randint_like(level, tiles.num_levels)
        level = torch.where(level >= tiles.num_levels, anywhere, level).clamp(min=0)
        if self._harness is not None:
            open_levels = ((1.0 - self._harness.scale) * tiles.num_levels).floor().to(torch.int64)
            level = torch.minimum(level, open_levels)
        tiles.set_level(torch.where(mask, level.clamp(max=tiles.num_levels - 1), tiles.level))
        return tiles.level

    def reset(self, mask: Tensor) -> None:
        """A new episode has been asked for nothing yet."""
        self._asked = self._asked.masked_fill(mask, 0.0)
