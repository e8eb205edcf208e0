"""Steering: whoever asks for whatever, the policy gets what it was trained for."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.deploy.contract import Commands
from humoslope.deploy.contract import Steering as Steer
from humoslope.deploy.steering import Steering

RANGES = st.tuples(st.floats(-1.0, 0.7), st.floats(0.1, 1.0)).map(lambda r: (round(r[0], 3), round(r[0] + r[1], 3)))
TURNS = st.floats(0.1, 1.0).map(lambda turn: (-round(turn, 3), round(turn, 3)))


def commands(
    forward: tuple[float, float] = (0.3, 0.8), turn: tuple[float, float] = (-0.3, 0.3), stand: bool = True
) -> Commands:
    return Commands(
        forward_m_s=forward,
        left_m_s=(0.0, 0.0),
        yaw_rate_rad_s=turn,
        trained_to_stand=stand,
        held_s=(1.0, 2.0),
        steering=Steer("clamp", 1.0, 1.0, turn[1]),
    )


@given(RANGES, TURNS, st.booleans(), st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=1))
def test_a_stick_asks_for_nothing_untrained(
    forward: tuple[float, float],
    turn: tuple[float, float],
    stand: bool,
    places: list[tuple[float, float]],
) -> None:
    steering = Steering(commands(forward, turn, stand), 0.5)
    for place in places:
        steering.push(*place)
        speed, left, yaw_rate = steering.command
        trained = forward[0] - 1e-9 <= speed <= forward[1] + 1e-9
        assert trained or (stand and speed == 0.0)
        assert left == 0.0
        assert turn[0] - 1e-9 <= yaw_rate <= turn[1] + 1e-9


@given(RANGES, st.booleans(), st.floats(-2, 2), st.floats(-2, 2))
def test_a_slider_asks_for_the_nearest_that_was_trained(
    forward: tuple[float, float], stand: bool, speed: float, turn: float
) -> None:
    steering = Steering(commands(forward, stand=stand), 0.5)
    steering.ask_speed(speed)
    steering.ask_turn(turn)
    asked, _, yaw_rate = steering.command
    possible = [min(max(speed, forward[0]), forward[1]), *([0.0] if stand else [])]
    assert abs(asked - speed) == pytest.approx(min(abs(value - speed) for value in possible))
    assert yaw_rate == min(max(turn, -0.3), 0.3)


def test_the_way_of_a_stick_is_the_trained_range() -> None:
    steering = Steering(commands(), 0.5)
    steering.push(1.0, 1.0)
    assert list(steering.command) == pytest.approx([0.8, 0.0, 0.3])
    steering.push(0.5, -1.0)
    assert list(steering.command) == pytest.approx([0.55, 0.0, -0.3])
    steering.push(-1.0, 0.0)  # it was not trained to walk backward
    assert list(steering.command) == [0.0, 0.0, 0.0]


def test_a_stick_back_walks_backward_where_that_was_trained() -> None:
    steering = Steering(commands(forward=(-0.4, 0.8)), 0.5)
    steering.push(-0.5, 0.0)
    assert steering.command[0] == pytest.approx(-0.2)


def test_a_policy_that_cannot_stand_walks_slowly_when_the_stick_is_let_go() -> None:
    steering = Steering(commands(stand=False), 0.5)
    assert not steering.stands
    steering.push(0.0, 0.0)
    assert steering.command[0] == 0.3
    steering.stand()
    assert steering.command[0] == 0.3
