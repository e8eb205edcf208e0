"""When episodes end, and whether that is a failure."""

from __future__ import annotations

import pytest
import torch

from humoslope.errors import UserError
from humoslope.managers import StatefulTerm, TerminationManager, TerminationTermCfg, Terms

N = 4


def fallen(env):
    return env.fallen


def late(env):
    return env.late


@pytest.fixture
def env(make_env, mask):
    # In world 0 nothing happens, 1 falls, 2 is late, 3 falls at the last moment.
    return make_env(N, fallen=mask(N, 1, 3), late=mask(N, 2, 3))


@pytest.fixture
def terminations(env):
    return TerminationManager(
        env, Terms(late=TerminationTermCfg(late, time_out=True), fallen=TerminationTermCfg(fallen))
    )


def test_a_fall_at_the_last_moment_is_a_failure_and_no_time_out(terminations):
    assert terminations.compute().tolist() == [False, True, True, True]
    assert terminations.terminated.tolist() == [False, True, False, True]
    assert terminations.time_outs.tolist() == [False, False, True, False]


def test_what_ended_the_last_step_does_not_end_this_one(env, terminations):
    terminations.compute()
    env.fallen, env.late = torch.zeros(N, dtype=torch.bool), torch.zeros(N, dtype=torch.bool)
    assert not terminations.compute().any()
    assert not terminations.terminated.any()
    assert not terminations.time_outs.any()


def test_the_share_of_each_reason_is_logged_over_the_episodes_that_end(env, terminations):
    terminations.reset(terminations.compute())
    logged = env.log.flush()
    assert logged["Termination/fallen"] == pytest.approx(2 / 3)
    assert logged["Termination/late"] == pytest.approx(2 / 3)


def test_episodes_that_do_not_count_are_left_out_of_the_shares(env, terminations, mask):
    terminations.reset(terminations.compute(), counted=mask(N, 0, 2, 3))
    logged = env.log.flush()
    assert logged["Termination/fallen"] == pytest.approx(1 / 2)
    assert logged["Termination/late"] == pytest.approx(1.0)


def test_without_terms_nothing_ends(env):
    terminations = TerminationManager(env, Terms())
    assert terminations.compute().tolist() == [False] * N


def test_stateful_terminations_are_reset_with_their_envs(env, mask):
    class Thrice(StatefulTerm):
        def __init__(self, env):
            self.count = env.zeros()

        def __call__(self, env):
            self.count = self.count + 1
            return self.count >= 3

        def reset(self, mask):
            self.count = self.count.masked_fill(mask, 0.0)

    terminations = TerminationManager(env, Terms(thrice=TerminationTermCfg(Thrice)))
    terminations.compute()
    terminations.compute()
    terminations.reset(mask(N, 0, 1))
    assert terminations.compute().tolist() == [False, False, True, True]


def test_a_reason_of_the_last_step_is_read_by_its_name(terminations):
    assert not terminations["late"].any()
    terminations.compute()
    assert terminations["late"].tolist() == [False, False, True, True]
    assert terminations["fallen"].tolist() == [False, True, False, True]
    with pytest.raises(UserError, match="termination 'falen' does not exist; did you mean 'fallen'"):
        terminations["falen"]


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (torch.zeros(N, 1, dtype=torch.bool), r"torch.bool of shape \(4, 1\)"),
        (torch.zeros(N), r"torch.float32 of shape \(4,\)"),
        (torch.tensor(False), r"torch.bool of shape \(\)"),
    ],
)
def test_a_value_that_would_be_made_something_of_is_refused(env, value, said):
    terminations = TerminationManager(env, Terms(odd=TerminationTermCfg(lambda env: value)))
    with pytest.raises(UserError, match=f"termination 'odd' returned {said}; it must be bool of shape \\(4,\\)"):
        terminations.compute()
