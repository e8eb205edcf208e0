"""Observation groups: noise, scale, history, and tensors that nobody writes again."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.managers import ObservationGroupCfg, ObservationManager, ObservationTermCfg, StatefulTerm, Terms

N = 4
EVERYWHERE = torch.ones(N, dtype=torch.bool)
NOWHERE = torch.zeros(N, dtype=torch.bool)


def speed(env):
    return env.speed


def angles(env):
    return env.angles


@pytest.fixture
def env(make_env):
    return make_env(N, speed=torch.zeros(N, 1), angles=torch.zeros(N, 2))


def manager(env, history=1, enable_corruption=False, **terms):
    group = ObservationGroupCfg(terms=Terms(**terms), history=history, enable_corruption=enable_corruption)
    return ObservationManager(env, Terms(actor=group))


def test_terms_stand_in_their_order_each_scaled(env):
    observations = manager(
        env, speed=ObservationTermCfg(speed, scale=2.0), angles=ObservationTermCfg(angles, scale=0.1)
    )
    env.speed, env.angles = torch.full((N, 1), 3.0), torch.tensor([[10.0, 20.0]]).expand(N, 2)
    assert observations.compute(NOWHERE)["actor"].tolist() == [[6.0, 1.0, 2.0]] * N


def test_every_group_is_computed(env):
    both = Terms(
        actor=ObservationGroupCfg(terms=Terms(speed=ObservationTermCfg(speed))),
        critic=ObservationGroupCfg(terms=Terms(speed=ObservationTermCfg(speed), angles=ObservationTermCfg(angles))),
    )
    result = ObservationManager(env, both).compute(EVERYWHERE)
    assert {name: tuple(value.shape) for name, value in result.items()} == {"actor": (N, 1), "critic": (N, 3)}


@given(noise=st.floats(0.01, 5.0), scale=st.floats(0.1, 10.0))
def test_noise_is_uniform_within_its_bounds_in_the_terms_own_unit(make_env, noise, scale):
    n = 2000
    env = make_env(n, speed=torch.full((n, 1), 3.0))
    observations = manager(env, enable_corruption=True, speed=ObservationTermCfg(speed, noise=noise, scale=scale))
    error = observations.compute(torch.zeros(n, dtype=torch.bool))["actor"] / scale - 3.0
    assert error.abs().max() <= noise * 1.0001 + 1e-5
    assert error.max() > 0.9 * noise
    assert error.min() < -0.9 * noise
    assert abs(error.mean()) < 0.1 * noise


def test_a_group_that_is_not_corrupted_has_no_noise(env):
    observations = manager(env, enable_corruption=False, speed=ObservationTermCfg(speed, noise=1.0))
    assert observations.compute(NOWHERE)["actor"].count_nonzero() == 0


def test_noise_can_come_from_elsewhere(env):
    terms = Terms(speed=ObservationTermCfg(speed, noise=2.0, scale=0.5), angles=ObservationTermCfg(angles, noise=1.0))
    asked = []

    def quarter(given, frame):
        asked.append((given, tuple(frame.shape)))
        return torch.full_like(frame, 0.25)

    group = ObservationGroupCfg(terms=terms, enable_corruption=True, noise_source=quarter)
    observations = ObservationManager(env, Terms(actor=group))
    assert observations.compute(NOWHERE)["actor"].tolist() == [[-0.5, -0.5, -0.5]] * N
    assert asked == [(env, (N, 3))]


def test_terms_without_noise_stay_exact_beside_noisy_ones(env):
    observations = manager(
        env, enable_corruption=True, speed=ObservationTermCfg(speed, noise=1.0), angles=ObservationTermCfg(angles)
    )
    noisy = observations.compute(NOWHERE)["actor"]
    assert (noisy[:, 0] != 0.0).all()
    assert noisy[:, 1:].count_nonzero() == 0


def test_history_stands_term_by_term_with_the_oldest_first(env):
    observations = manager(env, history=3, speed=ObservationTermCfg(speed), angles=ObservationTermCfg(angles))
    for t in (1.0, 2.0, 3.0, 4.0):
        env.speed, env.angles = torch.full((N, 1), t), torch.tensor([[10.0 * t, 100.0 * t]]).expand(N, 2)
        obs = observations.compute(EVERYWHERE if t == 1.0 else NOWHERE)["actor"]
    assert obs.tolist() == [[2.0, 3.0, 4.0, 20.0, 200.0, 30.0, 300.0, 40.0, 400.0]] * N


@pytest.mark.parametrize("known_rows", [lambda mask: slice(None), lambda mask: mask.nonzero().squeeze(1)])
def test_a_world_that_starts_anew_gets_a_history_of_its_first_frame_and_the_others_keep_theirs(env, mask, known_rows):
    env.sim = SimpleNamespace(known_empty=lambda mask: False, known_rows=known_rows)
    observations = manager(env, history=3, speed=ObservationTermCfg(speed))
    for t in (1.0, 2.0, 3.0):
        env.speed = torch.full((N, 1), t)
        observations.compute(EVERYWHERE if t == 1.0 else NOWHERE)
    env.speed = torch.full((N, 1), 9.0)
    obs = observations.compute(mask(N, 1))["actor"]
    assert obs[1].tolist() == [9.0, 9.0, 9.0]
    assert obs[[0, 2, 3]].tolist() == [[2.0, 3.0, 9.0]] * 3


def test_a_frame_keeps_the_noise_it_was_seen_with(env):
    observations = manager(env, history=2, enable_corruption=True, speed=ObservationTermCfg(speed, noise=1.0))
    first = observations.compute(NOWHERE)["actor"]
    second = observations.compute(NOWHERE)["actor"]
    assert second[:, 0].equal(first[:, 1])


@pytest.mark.parametrize("history", [1, 3])
def test_tensors_are_fresh_each_step_and_never_written_again(env, history):
    observations = manager(env, history=history, speed=ObservationTermCfg(speed))
    first = observations.compute(EVERYWHERE)["actor"]
    before = first.clone()
    env.speed += 1.0
    second = observations.compute(NOWHERE)["actor"]
    assert first.data_ptr() != second.data_ptr()
    assert first.equal(before)
    second.fill_(7.0)
    assert env.speed.tolist() == [[1.0]] * N


def test_stateful_terms_are_reset_for_the_worlds_in_the_mask_alone(env, mask):
    class Steps(StatefulTerm):
        def __init__(self, env):
            self.steps = env.zeros(1)

        def __call__(self, env):
            self.steps = self.steps + 1.0
            return self.steps

        def reset(self, mask):
            self.steps = self.steps.masked_fill(mask[:, None], 0.0)

    observations = manager(env, steps=ObservationTermCfg(Steps))
    before = observations.compute(NOWHERE)["actor"].flatten()
    observations.reset(mask(N, 2))
    after = observations.compute(NOWHERE)["actor"].flatten()
    assert after[2] == 1.0
    assert after[[0, 1, 3]].equal(before[[0, 1, 3]] + 1.0)


def test_a_term_of_the_wrong_shape_is_named(env):
    def flat(env):
        return env.zeros()

    with pytest.raises(UserError, match=r"observation 'actor\.flat' returned shape \(4,\); it must be \(4, d\)"):
        manager(env, flat=ObservationTermCfg(flat))


def test_a_history_of_no_step_is_refused(env):
    with pytest.raises(UserError, match="observation group 'actor': history 0 must be at least 1"):
        manager(env, history=0, speed=ObservationTermCfg(speed))
