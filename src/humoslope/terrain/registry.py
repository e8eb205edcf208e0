"""Terrains by name: a function of place and grade, and the check that what it returns can be a ground."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from humoslope.errors import UserError, unknown

Array = NDArray[np.float64]
HeightFunction = Callable[[Array, Array, float, np.random.Generator], Array]
_F = TypeVar("_F", bound=HeightFunction)

_REGISTRY: dict[str, Kind] = {}


@dataclass(frozen=True)
class Kind:
    """A registered terrain.

    Attributes:
        name: What columns of a grid are called by.
        grade: Range in degrees that difficulty 0..1 runs through.
        function: `(x, y, grade, rng) -> height`; x, y and height are [nx, ny] in metres, x from the start of the tile
            along the direction of travel, y from its centre line to the left, grade in degrees.
        training: Whether training may use it; what policies are measured on must be new to them.
    """

    name: str
    grade: tuple[float, float]
    function: HeightFunction
    training: bool = True

    def grade_at(self, difficulty: float) -> float:
        """Grade in degrees at a difficulty in [0, 1]."""
        low, high = self.grade
        return low + difficulty * (high - low)

    def heights(self, x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
        """Heights in metres at x, y [nx, ny]; raises `UserError` where the function returns anything else."""
        result = self.function(x, y, grade, rng)
        if not isinstance(result, np.ndarray):
            raise UserError(
                f"terrain '{self.name}' returned a {type(result).__name__}; "
                f"it must return a numpy array of heights in metres, shape {x.shape}."
            )
        if result.dtype.kind not in "fiu":
            raise UserError(
                f"terrain '{self.name}' returned an array of {result.dtype}; heights must be real numbers in metres."
            )
        if result.shape != x.shape:
            raise UserError(f"terrain '{self.name}' returned shape {result.shape}; it must be that of x, {x.shape}.")
        heights = result.astype(np.float64)
        bad = ~np.isfinite(heights)
        if bad.any():
            first = tuple(np.argwhere(bad)[0])
            raise UserError(
                f"terrain '{self.name}' returned {heights[first]} at x={x[first]:.2f}, y={y[first]:.2f} m "
                f"and grade {grade:.1f} degrees; every height must be finite."
            )
        return heights


def terrain(name: str, grade: tuple[float, float], *, training: bool = True) -> Callable[[_F], _F]:
    """Registers a height function under a name.

    Args:
        name: What a `TerrainGridCfg` and the command line call it.
        grade: Range in degrees that difficulty 0..1 runs through.
        training: Whether a `TerrainGridCfg` may hold it.
    Returns:
        A decorator that gives the function back unchanged.
    Raises:
        UserError: The name is taken, or the range is not two finite angles within 90 degrees, low first.
    """
    low, high = grade
    if not -90.0 < low <= high < 90.0:
        raise UserError(f"terrain '{name}' has grade {grade}; give (low, high) in degrees, between -90 and 90.")

    def register(function: _F) -> _F:
        if name in _REGISTRY:
            taken = _REGISTRY[name].function
            raise UserError(
                f"terrain '{name}' is registered twice, by {_where(taken)} and {_where(function)}; "
                "give one of them another name."
            )
        _REGISTRY[name] = Kind(name, (float(low), float(high)), function, training)
        return function

    return register


def find(name: str) -> Kind:
    """The terrain of that name; raises `UserError` with the nearest match if there is none."""
    if name not in _REGISTRY:
        raise unknown("terrain", name, _REGISTRY)
    return _REGISTRY[name]


def names() -> tuple[str, ...]:
    """All registered names, sorted."""
    return tuple(sorted(_REGISTRY))


def training_names() -> tuple[str, ...]:
    """The names of what training may use, sorted."""
    return tuple(name for name in names() if _REGISTRY[name].training)


def _where(function: HeightFunction) -> str:
    return f"{getattr(function, '__module__', '?')}.{getattr(function, '__qualname__', '?')}"
