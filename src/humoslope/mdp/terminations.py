"""Terminations; every function returns [N] bool."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import torch
from torch import Tensor

from humoslope.ranges import NotNegative, Range

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


def time_out(env: Env) -> Tensor:
    """Ends an episode that has lasted its full length."""
    return env.episode_length_buf >= env.max_episode_length


def root_too_low(env: Env, height: NotNegative) -> Tensor:
    """Ends an episode whose robot has its root close to the ground.

    Args:
        height: Least height of the root above the ground below it, m.
    """
    return env.signals.root_height < height


def tilted(env: Env, degrees: Annotated[float, Range(0.0, 180.0)]) -> Tensor:
    """Ends an episode whose robot leans too far.

    Args:
        degrees: Largest angle between the root's up axis and the vertical, degrees.
    """
    return env.signals.projected_gravity_b[:, 2] > -math.cos(math.radians(degrees))


OMNIDIRECTIONAL_MARGIN = 0.6
"""Least distance of the root from the edges of a tile that is walked in any direction, m. Half a stride and a foot: its
edges may be cliffs on all four sides, and the slope below the root is taken from heights within 0.4 m. Ours."""


def off_tile(env: Env, margin: NotNegative, omnidirectional_margin: NotNegative = OMNIDIRECTIONAL_MARGIN) -> Tensor:
    """Ends an episode whose robot has come to the edge of its tile.

    Args:
        margin: Least distance of the root from the edge, m.
        omnidirectional_margin: The same on tiles that are walked in any direction, m.
    """
    x, y = (env.signals.root_pos_w - env.tiles.origin_w).unbind(dim=1)[:2]
    tiles = env.tiles
    off = (x < margin) | (x > tiles.length - margin) | (y.abs() > 0.5 * tiles.width - margin)
    if not tiles.has_omnidirectional:
        return off
    wide = omnidirectional_margin
    near = (x < wide) | (x > tiles.length - wide) | (y.abs() > 0.5 * tiles.width - wide)
    return torch.where(tiles.omnidirectional, near, off)
