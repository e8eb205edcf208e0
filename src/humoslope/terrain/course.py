"""Courses: long tiles of named segments for evaluations, never for training."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import torch
from torch import Tensor

from humoslope.errors import UserError, unknown
from humoslope.terrain import registry
from humoslope.terrain.grid import Tile, TileRowCfg
from humoslope.terrain.registry import HeightFunction

_F = TypeVar("_F", bound=HeightFunction)

_COURSES: dict[str, Course] = {}


@dataclass(frozen=True)
class Segment:
    """Stretch of a course.

    Attributes:
        name: Name in pictures and tables.
        length: Extent along x, m.
        direction: Sign of the grade: +1 up, -1 down, 0 level.
        surface: Name of its surface, such as "rough". A label: the course's height function makes the surface.
    """

    name: str
    length: float
    direction: int
    surface: str

    def __post_init__(self) -> None:
        if not 0.0 < self.length < math.inf:
            raise UserError(f"segment '{self.name}': length is {self.length:g} m; it must be positive.")
        if self.direction not in (-1, 0, 1):
            raise UserError(f"segment '{self.name}': direction is {self.direction}; it must be -1, 0 or 1.")


@dataclass(frozen=True)
class Course:
    """Segments one after the other, at any nominal grade of a range.

    Attributes:
        name: Name of the course and of its terrain.
        segments: Segments from x = 0 on.
        height: Height function `(x, y, grade, rng) -> height`, as that of a terrain.
        grade: Least and largest nominal grade, degrees.
        width: Extent across, m; half of it to each side of the centre line.
        cell: Distance between neighbouring heights, m.
    """

    name: str
    segments: tuple[Segment, ...]
    height: HeightFunction
    grade: tuple[float, float]
    width: float
    cell: float

    @property
    def length(self) -> float:
        """Extent along x, m."""
        return self.ends[-1]

    @property
    def ends(self) -> tuple[float, ...]:
        """End of each segment, m from the start."""
        # Lengths are decimal fractions; their sums must not carry the error of binary ones.
        return tuple(round(end, 9) for end in itertools.accumulate(s.length for s in self.segments))

    def segment_at(self, x: Tensor) -> Tensor:
        """Index of the segment at each place `x` [...] along the course, int64 [...].

        A joint belongs to the segment that begins there; places beyond an end belong to the segment at that end.
        """
        inner = torch.tensor(self.ends[:-1], dtype=x.dtype, device=x.device)
        return torch.bucketize(x, inner, right=True)

    def ground(self, grades: Sequence[float]) -> TileRowCfg:
        """The course side by side at each of `grades`, in degrees.

        Raises:
            UserError: If a grade is outside the course's range.
        """
        low, high = self.grade
        for grade in grades:
            if not low <= grade <= high:
                raise UserError(f"course '{self.name}': grade {grade:g} must be between {low:g} and {high:g} degrees.")
        kind = registry.find(self.name)
        tiles = [Tile(kind, float(grade)) for grade in grades]
        return TileRowCfg(tiles, tile_length=self.length, tile_width=self.width, cell=self.cell)


def course(
    name: str, segments: Sequence[Segment], *, grade: tuple[float, float], width: float, cell: float
) -> Callable[[_F], _F]:
    """Registers a height function as a course, and as a terrain of that name which no training grid may hold.

    Args:
        name: Name for evaluations and the command line.
        segments, grade, width, cell: As in `Course`.

    Raises:
        UserError: If the name is taken.
    """

    def register(function: _F) -> _F:
        registry.terrain(name, grade, training=False)(function)
        _COURSES[name] = Course(name, tuple(segments), function, grade, width, cell)
        return function

    return register


def find(name: str) -> Course:
    """Returns the course called `name`; raises `UserError` with the nearest match if there is none."""
    if name not in _COURSES:
        raise unknown("course", name, _COURSES)
    return _COURSES[name]


def is_course(name: str) -> bool:
    """True if the terrain called `name` is a course."""
    return name in _COURSES
