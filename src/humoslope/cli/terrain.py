"""`humoslope terrain NAME`: draws a terrain."""

from __future__ import annotations

from pathlib import Path

import tyro

from humoslope.ranges import Seed, check
from humoslope.registry import load_content
from humoslope.terrain import draw


def terrain(name: str, /, out: Path | None = None, seed: Seed = 0) -> None:
    """Draws a registered terrain at several grades, from the side and from above, to a PNG.

    Args:
        name: Name of the terrain, such as ramp-up.
        out: Path of the PNG; by default NAME.png in the current folder.
        seed: Seed of the random bumps; 0 or more.
    """
    check("terrain", "seed", seed, Seed)
    path = draw.run(name, out if out is not None else Path(f"{name}.png"), seed=seed)
    print(f"wrote {path}")


def run(arguments: list[str]) -> None:
    """Draws the terrain named in `arguments`."""
    load_content()
    tyro.cli(terrain, args=arguments, prog="humoslope terrain")
