"""Terrains by name: height functions of place and grade, and the check of what they return."""

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
    """Registered terrain.

    Attributes:
        name: Name in a `TerrainGridCfg` and on the command line.
        grade: Grades at difficulty 0 and at difficulty 1, degrees.
        function: `(x, y, grade, rng) -> height`; x, y and height are [nx, ny] in metres, x from the start of the tile
            along the direction of travel, y from its centre line to the left, grade in degrees.
        training: True if training may use it; the ground of an evaluation must be new to the policies.
        omnidirectional: True if training robots start anywhere on its tiles and walk in any direction; False if they
            start at the start of a tile and walk along x.
    """

    name: str
    grade: tuple[float, float]
    function: HeightFunction
    training: bool = True
    omnidirectional: bool = False

    def grade_at(self, difficulty: float) -> float:
        """Grade in degrees at a difficulty in [0, 1]."""
        low, high = self.grade
        return low + difficulty * (high - low)

    def heights(self, x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
        """Heights at x, y [nx, ny], m.

        Raises:
            UserError: If the function returns anything else, or finds the tile too small.
        """
        try:
            result = self.function(x, y, grade, rng)
        except UserError as error:
            raise UserError(f"terrain '{self.name}': {error}") from None
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


def terrain(
    name: str, grade: tuple[float, float], *, training: bool = True, omnidirectional: bool = False
) -> Callable[[_F], _F]:
    """Registers a height function under a name.

    Args:
        name: Name in a `TerrainGridCfg` and on the command line.
        grade: Grades at difficulty 0 and at difficulty 1, degrees.
        training: True if a `TerrainGridCfg` may hold it.
        omnidirectional: True if robots start anywhere on its tiles and walk in any direction.

    Returns:
        Decorator that returns the function unchanged.

    Raises:
        UserError: If the name is taken, or the grades are not two angles between -90 and 90 degrees, low first.
    """
    angles = grade if isinstance(grade, tuple | list) and all(isinstance(g, int | float) for g in grade) else ()
    if len(angles) != 2 or not -90.0 < angles[0] <= angles[1] < 90.0:
        raise UserError(f"terrain '{name}' has grade {grade}; give (low, high) in degrees, between -90 and 90.")
    low, high = angles

    def register(function: _F) -> _F:
        if name in _REGISTRY:
            taken = _REGISTRY[name].function
            raise UserError(
                f"terrain '{name}' is registered twice, by {_where(taken)} and {_where(function)}; "
                "give one of them another name."
            )
        _REGISTRY[name] = Kind(name, (float(low), float(high)), function, training, omnidirectional)
        return function

    return register


def find(name: str) -> Kind:
    """Returns the terrain called `name`; raises `UserError` with the nearest match if there is none."""
    if name not in _REGISTRY:
        raise unknown("terrain", name, _REGISTRY)
    return _REGISTRY[name]


def names() -> tuple[str, ...]:
    """All registered names, sorted."""
    return tuple(sorted(_REGISTRY))


def _where(function: HeightFunction) -> str:
    return f"{getattr(function, '__module__', '?')}.{getattr(function, '__qualname__', '?')}"
