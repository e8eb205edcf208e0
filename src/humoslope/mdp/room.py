"""Room on the tiles: for the starts of robots, for what they are commanded, and for the way to the next level."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from humoslope.errors import UserError
from humoslope.mdp import terminations
from humoslope.mdp.curricula import TerrainLevels
from humoslope.ranges import parameters_of

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


def check_room(env: Env, along: tuple[float, float], across: float, edge: float) -> None:
    """Checks that tiles have room for the starts of robots and for their commands.

    Args:
        along: Range of the start on a tile walked along x, m from its spawn place.
        across: Largest distance of that start from the tile's centre line, m.
        edge: Least distance of a start from the edges of a tile walked in any direction, m.

    Raises:
        UserError: If not, with what would do.
    """
    ends = [term for _, term in env.cfg.terminations.items() if term.func is terminations.off_tile]
    margin = max((term.params["margin"] for term in ends), default=0.0)
    name, usual = "omnidirectional_margin", terminations.OMNIDIRECTIONAL_MARGIN
    wide = max((term.params.get(name, usual) for term in ends), default=0.0)
    if env.tiles.has_straight:
        _check_straight_tile(env, along, across, margin)
        _check_straight_commands(env, along, across, margin)
    if env.tiles.has_omnidirectional:
        _check_omnidirectional_tile(env, edge, wide)


def _check_omnidirectional_tile(env: Env, edge: float, margin: float) -> None:
    """Checks that a tile walked in any direction has room for starts, and for the commands of every mode."""
    tiles, cfg = env.tiles, env.cfg.command
    if edge < margin:
        raise UserError(
            f"on tiles walked in any direction robots start from {edge:g} m to the edge on, but within {margin:g} m of "
            f"it (omnidirectional_margin of off_tile) an episode ends; edge must be at least {margin:g} m."
        )
    for name in ("length", "width"):
        if getattr(tiles, name) < 2.0 * edge:
            raise UserError(
                f"the tile has a {name} of {getattr(tiles, name):g} m; for starts {edge:g} m from its edges "
                f"tile_{name} must be at least {2.0 * edge:g} m."
            )
    longest = math.hypot(tiles.length - edge - margin, tiles.width - edge - margin)
    for name in ("backward", "sideways"):
        if not cfg.asks_for(name):
            continue
        speed, shortest = getattr(cfg, name)[1], cfg.resample_s[0]
        if speed * shortest > longest:
            most = math.floor(100.0 * longest / shortest) / 100.0
            raise UserError(
                f"command: {name} goes up to {speed:g} m/s, for {shortest:g} s or longer, but no tile has more than "
                f"{longest:.3g} m of ground for it; it must be at most {most:g} m/s."
            )


def _check_straight_commands(env: Env, along: tuple[float, float], across: float, margin: float) -> None:
    """Checks that a tile walked along x has room for the shortest command backward or to a side."""
    tiles, cfg = env.tiles, env.cfg.command
    shortest = cfg.resample_s[0]
    rooms = (
        ("speed", -cfg.speed[0], tiles.spawn_x + along[0] - margin, "behind the start"),
        ("lateral", max(abs(bound) for bound in cfg.lateral), 0.5 * tiles.width - across - margin, "beside the start"),
    )
    for name, speed, room, where in rooms:
        if speed * shortest > room + 1e-9:
            raise UserError(
                f"command: {name} {_shown(getattr(cfg, name))} m/s carries a robot {speed * shortest:g} m in "
                f"{shortest:g} s, but a tile walked along x has only {room:.3g} m {where}; use modes, on ground that "
                "is walked in any direction such as 'hillside'."
            )


def _rounded_up(metres: float) -> float:
    """To millimetres, upwards, so that what a message proposes is enough."""
    return math.ceil(1000.0 * metres) / 1000.0


def _shown(values: tuple[float, float]) -> str:
    return f"({values[0]:g}, {values[1]:g})"


def _check_straight_tile(env: Env, along: tuple[float, float], across: float, margin: float) -> None:
    """Checks that robots start, and can earn the next level, before they are at the edge of a tile walked along x.

    Raises:
        UserError: If not, with the length or width that would do.
    """
    tiles = env.tiles
    first, last = (tiles.spawn_x + offset for offset in along)
    if first < margin:
        raise UserError(
            f"robots start from {first:g} m on, but within {margin:g} m of the tile's edge (margin of off_tile) an "
            f"episode ends; along must be at least {margin - tiles.spawn_x:g} m, or the margin at most {first:g} m."
        )
    needs = {"the start": last + margin}
    for _, term in env.cfg.curriculum.items():
        usual_up = parameters_of(TerrainLevels)["up"].default
        up = term.params.get("up", usual_up) if term.func is TerrainLevels else 0.0
        if up == 1.0 and margin > 0.0:
            raise UserError(f"up 1 of TerrainLevels cannot be reached with a margin of {margin:g} m at the tile's end.")
        if up > 0.0:
            needs[f"{up:.0%} of the way"] = last + margin / (1.0 - up) if margin else last
    reason = max(needs, key=lambda name: needs[name])
    if tiles.length < needs[reason]:
        raise UserError(
            f"the tile is {tiles.length:g} m long; for {reason} and a margin of {margin:g} m at its end tile_length "
            f"must be at least {_rounded_up(needs[reason]):g} m."
        )
    if tiles.width < 2.0 * (across + margin):
        raise UserError(
            f"the tile is {tiles.width:g} m wide; for a start up to {across:g} m off its middle and a margin of "
            f"{margin:g} m at its sides tile_width must be at least {_rounded_up(2.0 * (across + margin)):g} m."
        )
