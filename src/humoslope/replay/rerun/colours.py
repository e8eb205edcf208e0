"""Colours of quantities, the same in the 3D view and in plots; (red, green, blue) in 0..255."""

from __future__ import annotations

from matplotlib import colormaps

Colour = tuple[int, int, int]

COMMANDED: Colour = (66, 133, 244)
ACTUAL: Colour = (251, 140, 0)
SUPPORT: Colour = (0, 172, 193)
ZMP: Colour = (229, 57, 53)
COM: Colour = (171, 71, 188)
TARGET: Colour = (121, 134, 203)
FORCE: Colour = (253, 216, 53)
NORMAL: Colour = (67, 160, 71)


def palette(count: int) -> list[Colour]:
    """Returns `count` distinguishable colours; they repeat after twenty."""
    table = colormaps["tab20"].colors  # type: ignore[attr-defined]
    # The table alternates dark and light shades; the dark ones first are easier to distinguish.
    order = [*range(0, 20, 2), *range(1, 20, 2)]
    red_green_blue = [table[order[i % 20]] for i in range(count)]
    return [(round(255 * r), round(255 * g), round(255 * b)) for r, g, b in red_green_blue]


def paler(colour: Colour, share: float = 0.5) -> Colour:
    """Returns the colour mixed with a share of white."""
    red, green, blue = (round(part + share * (255 - part)) for part in colour)
    return red, green, blue
