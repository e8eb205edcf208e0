"""Curricula look at the episodes that end, and are part of the checkpoint."""

from __future__ import annotations

import pytest
import torch

from humoslope.errors import UserError
from humoslope.managers import CurriculumManager, StatefulTerm, TermCfg, Terms

N = 4


class Level(StatefulTerm):
    """One level up for each finished episode."""

    def __init__(self, env, start=0.0):
        self.level = env.zeros() + start
        self.forgotten = []

    def __call__(self, env, mask):
        self.level = self.level + mask
        return self.level

    def reset(self, mask):
        self.forgotten.append(mask)

    def state_dict(self):
        return {"level": self.level.tolist()}

    def load_state_dict(self, state):
        self.level = torch.tensor(state["level"])


def quiet(env, mask):
    return torch.tensor(2.5)


@pytest.fixture
def env(make_env):
    return make_env(N)


def test_a_term_sees_the_worlds_that_end_is_logged_and_then_reset(env, mask):
    curriculum = CurriculumManager(env, Terms(level=TermCfg(Level, {"start": 1.0}), quiet=TermCfg(quiet)))
    curriculum.reset(mask(N, 0, 1))
    assert env.log.flush() == {"Curriculum/level": 1.5, "Curriculum/quiet": 2.5}
    assert curriculum["level"].forgotten[0].equal(mask(N, 0, 1))


def test_a_term_may_build_on_one_before_it(env):
    class Follower(StatefulTerm):
        def __init__(self, env):
            self.leader = env.curriculum["level"]

        def reset(self, mask):
            pass

    curriculum = CurriculumManager(env, Terms(level=TermCfg(Level), follower=TermCfg(Follower)))
    assert curriculum["follower"].leader is curriculum["level"]


def test_what_terms_have_to_keep_comes_back(env, mask):
    terms = Terms(level=TermCfg(Level), quiet=TermCfg(quiet))
    curriculum = CurriculumManager(env, terms)
    curriculum.reset(mask(N, 2))
    state = curriculum.state_dict()
    assert state == {"level": {"level": [0.0, 0.0, 1.0, 0.0]}}
    other = CurriculumManager(env, terms)
    other.load_state_dict(state)
    assert other["level"].level.tolist() == [0.0, 0.0, 1.0, 0.0]


def test_a_term_that_is_gone_is_ignored_and_a_new_one_keeps_its_start(env):
    curriculum = CurriculumManager(env, Terms(other=TermCfg(Level, {"start": 3.0})))
    curriculum.load_state_dict({"level": {"level": [1.0] * N}})
    assert curriculum["other"].level.tolist() == [3.0] * N


def test_a_term_that_does_not_exist_is_named_with_the_nearest_one(env):
    curriculum = CurriculumManager(env, Terms(level=TermCfg(Level)))
    with pytest.raises(UserError, match="curriculum 'levle' does not exist; did you mean 'level'"):
        curriculum["levle"]
