"""A course: one long tile of named segments that policies are measured on and never trained on."""

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
    """A stretch of a course.

    Attributes:
        name: Shown in pictures and tables.
        length: Extent along x, m.
        direction: Of the nominal grade: +1 up, -1 down, 0 level.
        surface: What lies on it, such as "rough".
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
        name: Also that of its terrain.
        segments: From x = 0 on.
        height: `(x, y, grade, rng) -> height`, as of a terrain.
        grade: Range of the nominal grade, degrees.
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
        """Where each segment ends, m from the start."""
        # Lengths are decimal fractions; their sums must not carry the error of binary ones.
        return tuple(round(end, 9) for end in itertools.accumulate(s.length for s in self.segments))

    def segment_at(self, x: Tensor) -> Tensor:
        """Index of the segment at each place `x` [...] along the course, int64 [...]; beyond an end, that end's.
        A joint belongs to the segment that begins there."""
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
        name: What evaluations and the command line call it.
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
    """The course of that name; raises `UserError` with the nearest match if there is none."""
    if name not in _COURSES:
        raise unknown("course", name, _COURSES)
    return _COURSES[name]


def is_course(name: str) -> bool:
    """Whether a terrain is a course."""
    return name in _COURSES
