"""Reasons to end an episode; every function returns [N] bool."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from torch import Tensor

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


def time_out(env: Env) -> Tensor:
    """The episode has lasted its full length."""
    return env.episode_length_buf >= env.max_episode_length


def root_too_low(env: Env, height: float) -> Tensor:
    """The root is less than `height` m above the ground below it."""
    return env.signals.root_height < height


def tilted(env: Env, degrees: float) -> Tensor:
    """The root leans more than `degrees` away from the vertical."""
    return env.signals.projected_gravity_b[:, 2] > -math.cos(math.radians(degrees))


def off_tile(env: Env, margin: float) -> Tensor:
    """The root has left its tile, or come closer than `margin` m to its edge."""
    x, y = (env.signals.root_pos_w - env.tiles.origin_w).unbind(dim=1)[:2]
    tiles = env.tiles
    return (x < margin) | (x > tiles.length - margin) | (y.abs() > 0.5 * tiles.width - margin)
