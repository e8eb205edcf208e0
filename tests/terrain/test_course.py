"""A course is one long tile whose segments are known by place, and which nobody may train on."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.terrain import TerrainGridCfg, course, registry
from humoslope.terrain.course import Course, Segment

LENGTHS = st.lists(st.integers(1, 50).map(lambda tenths: tenths / 10), min_size=1, max_size=12)


def make(lengths: list[float]) -> Course:
    segments = tuple(Segment(f"s{i}", length, 0, "smooth") for i, length in enumerate(lengths))
    return Course("made", segments, lambda x, y, grade, rng: np.zeros_like(x), (0.0, 30.0), 6.0, 0.1)


@given(lengths=LENGTHS, x=st.floats(-5.0, 60.0))
def test_a_place_is_in_the_segment_that_reaches_over_it(lengths: list[float], x: float) -> None:
    made = make(lengths)
    index = int(made.segment_at(torch.tensor([x], dtype=torch.float64)))
    starts = [0.0, *made.ends]
    if 0.0 <= x < made.length:
        assert starts[index] <= x < starts[index + 1]
    else:
        assert index == (0 if x < 0.0 else len(lengths) - 1)


def test_lengths_that_are_decimals_add_up_to_one() -> None:
    assert make([0.1] * 35).length == 3.5


def test_a_joint_belongs_to_the_segment_that_begins_there() -> None:
    assert make([2.0, 4.0]).segment_at(torch.tensor([1.999, 2.0, 6.0])).tolist() == [0, 1, 1]


@pytest.mark.parametrize(("length", "direction", "said"), [(0.0, 0, "length is 0 m"), (1.0, 2, "direction is 2")])
def test_an_impossible_segment_is_refused(length: float, direction: int, said: str) -> None:
    with pytest.raises(UserError, match=said):
        Segment("odd", length, direction, "smooth")


def test_a_course_is_found_by_name_and_a_misspelt_one_gets_its_nearest_match() -> None:
    assert course.find("held-out-track").name == "held-out-track"
    with pytest.raises(UserError, match="did you mean 'held-out-track'"):
        course.find("held-out-trak")


def test_a_course_is_a_terrain_but_none_that_training_may_use() -> None:
    assert "held-out-track" in registry.names()
    assert not registry.find("held-out-track").training
    assert course.is_course("held-out-track")
    assert not course.is_course("ramp-up")
    with pytest.raises(UserError, match="'held-out-track' is for evaluation only"):
        TerrainGridCfg(columns={"ramp-up": 1.0, "held-out-track": 0.0}).build()


def test_a_grade_that_the_course_does_not_have_is_refused() -> None:
    with pytest.raises(UserError, match="grade 41 must be between 0 and 40 degrees"):
        course.find("held-out-track").ground((0.0, 41.0))
