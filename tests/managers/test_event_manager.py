"""When events strike, and which envs."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.managers import EventManager, EventTermCfg, StatefulTerm, Terms

N = 50


def strike(env, mask, name):
    env.struck.append((name, mask.clone()))


@pytest.fixture
def env(make_env):
    return make_env(N, struck=[])


def event(name, **options):
    return EventTermCfg(strike, {"name": name}, **options)


def test_each_event_strikes_in_its_own_mode(env, mask):
    events = EventManager(
        env,
        Terms(once=event("once", mode="startup"), anew=event("anew", mode="reset"), ever=event("ever", mode="step")),
    )
    assert env.struck == []
    events.startup()
    events.reset(mask(N, 3))
    events.step()
    assert [name for name, _ in env.struck] == ["once", "anew", "ever"]
    assert [int(struck.sum()) for _, struck in env.struck] == [N, 1, N]
    assert env.struck[1][1][3]


def test_interval_events_strike_each_world_within_their_interval_and_again_and_again(env):
    events = EventManager(env, Terms(push=event("push", mode="interval", interval_s=(0.5, 1.0))))
    for _ in range(250):
        events.step()
    struck = torch.stack([struck for _, struck in env.struck])  # [steps, N]
    assert len(struck) == 250
    for world in range(N):
        times = 0.02 * (struck[:, world].nonzero().flatten() + 1)
        gaps = torch.diff(times, prepend=torch.zeros(1))
        assert gaps.min() >= 0.5 - 1e-5
        assert gaps.max() <= 1.0 + 1e-5
        assert len(gaps) >= 4
    first = struck.to(torch.int8).argmax(dim=0)
    assert first.unique().numel() > 10  # not all envs at once


def test_interval_events_are_not_called_where_nobody_is_known_to_be_due(make_env):
    env = make_env(1, struck=[], sim=SimpleNamespace(known_empty=lambda mask: not mask.any()))
    events = EventManager(env, Terms(push=event("push", mode="interval", interval_s=(0.5, 0.5))))
    for step in range(1, 56):
        events.step()
        assert len(env.struck) == step // 25
    assert [struck.tolist() for _, struck in env.struck] == [[True]] * 2


@given(dt=st.sampled_from([0.004, 0.01, 0.02, 0.1 / 3]), steps=st.integers(1, 400))
def test_an_interval_counts_whole_control_steps(make_env, dt, steps):
    env = make_env(2, struck=[], step_dt=dt)
    events = EventManager(env, Terms(push=event("push", mode="interval", interval_s=(steps * dt, steps * dt))))
    for _ in range(3 * steps):
        events.step()
    struck = torch.stack([struck for _, struck in env.struck])
    assert (struck[:, 0].nonzero().flatten() + 1).tolist() == [steps, 2 * steps, 3 * steps]


def test_stateful_events_are_reset_with_the_envs_and_can_be_had_by_name(env, mask):
    class Wind(StatefulTerm):
        def __init__(self, env, force):
            self.force, self.forgotten = force, []

        def __call__(self, env, mask):
            pass

        def reset(self, mask):
            self.forgotten.append(mask)

    events = EventManager(env, Terms(wind=EventTermCfg(Wind, {"force": 3.0}, mode="step")))
    events.reset(mask(N, 1))
    assert events["wind"].force == 3.0
    assert events["wind"].forgotten[0].equal(mask(N, 1))


def test_an_event_that_does_not_exist_is_named_with_the_nearest_one(env):
    events = EventManager(env, Terms(harness=event("harness", mode="step")))
    with pytest.raises(UserError, match="event 'harnes' does not exist; did you mean 'harness'"):
        events["harnes"]


def test_a_mode_that_does_not_exist_is_refused(env):
    with pytest.raises(UserError, match="event 'push': mode 'sometimes' does not exist; there are startup, reset"):
        EventManager(env, Terms(push=event("push", mode="sometimes")))


@pytest.mark.parametrize(
    ("interval", "message"),
    [
        (None, "None must be two positive durations in s, the shortest first"),
        ((2.0, 1.0), r"\(2.0, 1.0\) must be two positive durations in s, the shortest first"),
        ((float("nan"), 1.0), ".* must be two positive durations in s, the shortest first"),
        ((0.0, 1.0), "is 0 s; it must be finite and at least one control step of 0.02 s"),
        ((-1.0, 1.0), "is -1 s; it must be finite"),
        ((0.005, 1.0), "is 0.005 s; it must be finite"),
        ((1.0, float("inf")), "is inf s; it must be finite"),
    ],
)
def test_an_interval_that_is_none_is_refused(env, interval, message):
    with pytest.raises(UserError, match=f"event 'push': interval_s {message}"):
        EventManager(env, Terms(push=event("push", mode="interval", interval_s=interval)))


def test_an_event_takes_no_mask_as_a_parameter(env):
    with pytest.raises(UserError, match="event 'push': parameter 'mask' does not exist"):
        EventManager(env, Terms(push=EventTermCfg(strike, {"name": "push", "mask": None})))
