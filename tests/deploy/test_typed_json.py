"""JSON becomes typed, and what does not fit is named by its path."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.deploy.contract import _pretty
from humoslope.deploy.typed_json import typed
from humoslope.errors import UserError


@dataclass(frozen=True)
class Leg:
    name: str
    length: float


@dataclass(frozen=True)
class Robot:
    legs: tuple[Leg, ...]
    size: tuple[float, float]
    count: int
    awake: bool
    kind: Literal["walker"]
    parent: Leg | None
    note: str = ""


ROBOT: dict[str, Any] = {
    "legs": [{"name": "left", "length": 1}],
    "size": [0.5, 2.0],
    "count": 1,
    "awake": True,
    "kind": "walker",
    "parent": None,
}


def test_objects_lists_and_numbers_become_what_they_are_declared_as() -> None:
    robot = typed(Robot, ROBOT)
    assert robot == Robot((Leg("left", 1.0),), (0.5, 2.0), 1, True, "walker", None)
    assert isinstance(robot.legs[0].length, float)
    assert typed(Robot, json.loads(json.dumps(asdict(robot)))) == robot


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"legs": [{"name": "left", "length": "long"}]}, "legs[0].length is 'long'; it must be a number"),
        ({"legs": [{"name": "left"}]}, "field 'legs[0].length' is missing"),
        ({"legs": [{"name": "left", "lenght": 1.0}]}, "did you mean 'legs[0].length'?"),
        ({"legs": "left"}, "legs is 'left'; it must be a list"),
        ({"legs": ["left"]}, "legs[0] must be an object with fields"),
        ({"size": [1.0]}, "size has 1 entries; it must have 2"),
        ({"count": 1.5}, "count is 1.5; it must be a whole number"),
        ({"count": True}, "count is True; it must be a whole number"),
        ({"awake": 1}, "awake is 1; it must be true or false"),
        ({"kind": "swimmer"}, "kind is 'swimmer'; this version reads only 'walker'"),
        ({"parent": 3}, "parent must be an object with fields"),
        ({"note": None}, "note is None; it must be a text"),
        ({"size": [1.0, float("nan")]}, "size[1] is nan; it must be a number"),
    ],
)
def test_a_mistake_is_named_by_its_path(change: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError) as error:
        typed(Robot, ROBOT | change)
    assert said in str(error.value)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=30), inner, max_size=5),
    max_leaves=15,
)


@given(json_values)
def test_laying_out_a_contract_for_reading_loses_nothing(value: Any) -> None:
    assert json.loads(_pretty(value, "")) == value
