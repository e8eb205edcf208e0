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
def test_an_env_that_starts_anew_gets_a_history_of_its_first_frame_and_the_others_keep_theirs(env, mask, known_rows):
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


def test_stateful_terms_are_reset_for_the_envs_in_the_mask_alone(env, mask):
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

    with pytest.raises(
        UserError, match=r"observation 'actor\.flat' returned shape \(4,\); it must be \(4, d\) or \(4, C, "
    ):
        manager(env, flat=ObservationTermCfg(flat))


@pytest.mark.parametrize("known_rows", [lambda mask: slice(None), lambda mask: mask.nonzero().squeeze(1)])
def test_a_term_of_any_shape_is_scaled_and_stacked_along_its_first_dimension(make_env, mask, known_rows):
    sim = SimpleNamespace(known_empty=lambda mask: False, known_rows=known_rows)
    env = make_env(N, sim=sim, image=torch.zeros(N, 2, 3, 5))
    observations = manager(env, history=3, image=ObservationTermCfg(lambda env: env.image, scale=0.5))
    group = observations.groups["actor"]
    assert (group.shape, group.term_shapes, group.history) == ((6, 3, 5), {"image": (2, 3, 5)}, 3)
    images = [torch.rand(N, 2, 3, 5) for _ in range(4)]
    for t, env.image in enumerate(images):
        obs = observations.compute(EVERYWHERE if t == 0 else mask(N, 1) if t == 3 else NOWHERE)["actor"]
    assert obs[[0, 2, 3]].equal(0.5 * torch.cat(images[1:], dim=1)[[0, 2, 3]])
    assert obs[1].equal(0.5 * images[3].repeat(1, 3, 1, 1)[1])


def test_noise_on_a_term_of_any_shape_is_drawn_for_every_value(make_env):
    env = make_env(N, image=torch.zeros(N, 2, 30, 50))
    term = ObservationTermCfg(lambda env: env.image, noise=0.4, scale=0.5)
    obs = manager(env, enable_corruption=True, image=term).compute(NOWHERE)["actor"]
    assert obs.shape == (N, 2, 30, 50)
    assert obs.unique().numel() > 0.9 * obs.numel()
    assert 0.19 < obs.max() <= 0.2
    assert -0.2 <= obs.min() < -0.19


def test_a_term_that_is_no_vector_must_be_alone_in_its_group(make_env):
    env = make_env(N, speed=torch.zeros(N, 1), image=torch.zeros(N, 2, 3))
    image, vector = ObservationTermCfg(lambda env: env.image), ObservationTermCfg(speed)
    message = r"observation 'actor.image' returned shape \(4, 2, 3\); a term that is no vector must be the only one in"
    for terms in ({"speed": vector, "image": image}, {"image": image, "other": image}):
        with pytest.raises(UserError, match=message):
            manager(env, **terms)


def test_a_group_of_vectors_is_described(env):
    group = manager(env, history=2, speed=ObservationTermCfg(speed), angles=ObservationTermCfg(angles)).groups["actor"]
    assert (group.shape, group.term_shapes, group.history) == ((6,), {"speed": (1,), "angles": (2,)}, 2)


class Steps(StatefulTerm):
    """Counts its calls since the reset, in place, and keeps the environment."""

    def __init__(self, env):
        self.env, self.steps = env, env.zeros(1)

    def __call__(self, env):
        assert self.env is env
        self.steps += 1.0
        return self.steps.clone()

    def reset(self, mask):
        self.steps.masked_fill_(mask[:, None], 0.0)


def test_the_terminal_observation_is_that_of_a_step_more_and_leaves_no_trace(env):
    terms = {"speed": ObservationTermCfg(speed, scale=2.0), "steps": ObservationTermCfg(Steps)}
    observations, twin = (manager(env, history=3, **terms) for _ in range(2))
    for t in (1.0, 2.0, 3.0):
        env.speed = torch.full((N, 1), t)
        for one in (observations, twin):
            one.compute(EVERYWHERE if t == 1.0 else NOWHERE)
    env.speed = torch.full((N, 1), 4.0)
    terminal = [observations.terminal()["actor"] for _ in range(2)]
    assert terminal[0].equal(terminal[1])
    assert terminal[0].equal(twin.compute(NOWHERE)["actor"])
    assert observations.compute(NOWHERE)["actor"].equal(terminal[0])


@pytest.mark.parametrize("enable_corruption", [False, True])
def test_a_value_that_is_not_finite_is_reported_by_group_and_term_without_its_history(env, enable_corruption):
    both = Terms(
        actor=ObservationGroupCfg(Terms(speed=ObservationTermCfg(speed)), 3, enable_corruption),
        critic=ObservationGroupCfg(Terms(speed=ObservationTermCfg(speed), angles=ObservationTermCfg(angles))),
    )
    observations = ObservationManager(env, both)
    observations.compute(EVERYWHERE)
    assert env.finite.report() == []
    env.finite.step, good = 7, env.angles
    env.angles = torch.tensor([[torch.nan, 0.0], [0.0, torch.inf], [0.0, 0.0], [torch.nan, torch.nan]])
    observations.compute(NOWHERE)
    assert env.finite.report() == [
        "observation 'critic.angles' was not finite in 3 of 4 envs (first in step 7 since the last look)"
    ]
    env.angles, env.speed = good, torch.tensor([[torch.nan], [0.0], [0.0], [0.0]])
    observations.compute(NOWHERE)
    assert len(env.finite.report()) == 2  # of the actor and of the critic
    env.speed = torch.zeros(N, 1)
    observations.compute(NOWHERE)
    assert env.finite.report() == []  # though the actor's history still holds it


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scale": float("nan")}, "scale is nan; it must be a finite number"),
        ({"scale": float("inf")}, "scale is inf; it must be a finite number"),
        ({"noise": -1.0}, "noise is -1; it must be 0 or more"),
        ({"noise": float("nan")}, "noise is nan; it must be 0 or more"),
    ],
)
def test_a_scale_or_noise_that_is_no_such_number_is_refused(env, change, message):
    with pytest.raises(UserError, match=rf"observation group 'actor'\.terms\.speed\.{message}"):
        manager(env, speed=ObservationTermCfg(speed, **change))


def test_a_group_without_terms_is_refused(env):
    with pytest.raises(UserError, match="observation group 'actor' has no terms"):
        manager(env)


def test_a_history_of_no_step_is_refused(env):
    with pytest.raises(UserError, match=r"observation group 'actor'\.history is 0; it must be between 1 and 1,000"):
        manager(env, history=0, speed=ObservationTermCfg(speed))
