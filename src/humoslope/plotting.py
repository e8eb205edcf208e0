"""Figures without pyplot, so that neither a screen nor the backend that the user chose matters."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from humoslope.errors import UserError
from humoslope.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK = "#333333"
"""Colour of text and outlines."""


def with_ending(path: Path) -> Path:
    """`path` of a picture, as PNG where it has no ending."""
    return path if path.suffix else path.with_suffix(".png")


def new_figure(width: float = 6.4, height: float = 4.8, title: str = "") -> Figure:
    """An empty figure of this size in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, color=INK, fontsize=13)
    return figure


def dress(axis: Axes, size: float = 8.0) -> None:
    """Gives an axis its grid, its tick labels of this font size and no frame on the top and on the right."""
    axis.grid(color="0.92")
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=size, colors=INK)
    axis.spines[["top", "right"]].set_visible(False)


def save_figure(figure: Figure, path: Path, dpi: int = 130) -> None:
    """Writes a figure in one step; the ending of the path says in which format.

    Raises:
        UserError: If it cannot be written.
    """
    try:
        write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=dpi))
    except OSError as error:
        raise UserError(f"cannot write the figure '{path}': {error.strerror or error}.") from None
    except ValueError as error:  # an ending that matplotlib does not know
        raise UserError(f"cannot write the figure '{path}': {error}.") from None
