"""When a leg swings, by the forces on both feet."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from humoslope.mdp.bsga_memory import SWING_FORCE, SWING_LONGEST, SWING_SETTLE, Swing

STEPS, FULL = 60, 300.0
SETTLE = 4  # steps in the air before the one that completes a tenth of a second


def swings(make_env: Callable[..., SimpleNamespace], force: Tensor) -> Tensor:
    """Which legs swing [T, 2] in one world, by the vertical force on the feet [T, 2]."""
    env = make_env(1, signals=SimpleNamespace())
    swing = Swing(env, SWING_FORCE, SWING_SETTLE, SWING_LONGEST)
    found = []
    for now in force:
        env.signals.foot_force = now[None]
        found.append(swing.step(env)[0])
    return torch.stack(found)


def where(mask: Tensor) -> list[int]:
    return mask.nonzero().flatten().tolist()


@settings(max_examples=15)
@given(lift=st.integers(0, 30), time=st.integers(1, 30), foot=st.integers(0, 1))
def test_a_leg_swings_from_a_tenth_of_a_second_after_lift_off_until_its_foot_lands(make_env, lift, time, foot):
    force = torch.full((STEPS, 2), FULL)
    force[lift : lift + time, foot] = SWING_FORCE - 0.1
    found = swings(make_env, force)
    assert where(found[:, foot]) == list(range(lift + SETTLE, lift + time))
    assert not found[:, 1 - foot].any()


def test_a_touch_starts_the_swing_anew(make_env):
    force = torch.full((STEPS, 2), FULL)
    force[20:40, 0] = 0.0
    force[30, 0] = SWING_FORCE
    assert where(swings(make_env, force)[:, 0]) == [24, 25, 26, 27, 28, 29, 35, 36, 37, 38, 39]


def test_a_foot_that_is_held_up_swings_no_more_after_its_time(make_env):
    force = torch.full((STEPS, 2), FULL)
    force[10:, 0] = 0.0
    found = where(swings(make_env, force)[:, 0])
    assert (found[0], found[-1]) == (14, 39)  # 0.1 s and 0.6 s after lift-off, to the step


def test_no_leg_swings_while_both_are_in_the_air(make_env):
    force = torch.full((STEPS, 2), FULL)
    force[10:30, 0] = 0.0
    force[20:40, 1] = 0.0
    found = swings(make_env, force)
    assert where(found[:, 0]) == [14, 15, 16, 17, 18, 19]
    assert where(found[:, 1]) == list(range(30, 40))
