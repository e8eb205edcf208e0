"""Curricula are stepped, see the episodes that end, and are part of the checkpoint."""

from __future__ import annotations

import pytest
import torch

from humoslope.errors import UserError
from humoslope.managers import CurriculumManager, CurriculumTerm, StatefulTerm, TermCfg, Terms

N = 4


class Level(CurriculumTerm):
    """One level up for each finished episode."""

    def __init__(self, env, start=0.0):
        self.level = env.zeros() + start
        self.steps = 0

    def step(self, env):
        self.steps += 1
        return self.level

    def reset(self, mask):
        self.level = self.level + mask

    def state_dict(self):
        return {"level": self.level.tolist()}

    def load_state_dict(self, state):
        self.level = torch.tensor(state["level"])


def quiet(env, mask):
    return torch.tensor(2.5)


@pytest.fixture
def env(make_env):
    return make_env(N)


def test_a_term_is_logged_in_every_step_and_sees_the_envs_that_end_in_its_reset(env, mask):
    curriculum = CurriculumManager(env, Terms(level=TermCfg(Level, {"start": 1.0})))
    curriculum.step()
    curriculum.reset(mask(N, 0, 1))
    curriculum.step()
    assert curriculum["level"].steps == 2
    assert curriculum["level"].level.tolist() == [2.0, 2.0, 1.0, 1.0]
    assert env.log.flush() == {"Curriculum/level": 1.25}


def test_a_function_is_called_with_the_envs_that_end_and_with_nothing_in_between(env, mask):
    seen = []

    def difficulty(env, mask, least):
        seen.append(mask)
        return torch.tensor(least)

    curriculum = CurriculumManager(env, Terms(difficulty=TermCfg(difficulty, {"least": 2.5})))
    curriculum.step()
    assert not seen
    assert env.log.flush() == {}
    curriculum.reset(mask(N, 2))
    assert seen[0].equal(mask(N, 2))
    assert env.log.flush() == {"Curriculum/difficulty": 2.5}


def test_a_class_that_is_no_curriculum_is_refused(env):
    class Memory(StatefulTerm):
        def __init__(self, env):
            pass

        def reset(self, mask):
            pass

    with pytest.raises(UserError, match="curriculum 'memory': class Memory must derive from CurriculumTerm"):
        CurriculumManager(env, Terms(memory=TermCfg(Memory)))


def test_a_term_without_state_puts_nothing_into_the_checkpoint(env):
    class Fixed(CurriculumTerm):
        def __init__(self, env):
            pass

        def step(self, env):
            return torch.tensor(1.0)

    curriculum = CurriculumManager(env, Terms(fixed=TermCfg(Fixed)))
    assert curriculum.state_dict() == {}
    curriculum.load_state_dict({"fixed": {"level": 1.0}})


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


@pytest.mark.parametrize(
    ("difficulty", "logged"), [(2, {"Curriculum/level": 2.0}), (0.5, {"Curriculum/level": 0.5}), (None, {})]
)
def test_a_function_may_return_a_number_or_nothing(env, mask, difficulty, logged):
    curriculum = CurriculumManager(env, Terms(level=TermCfg(lambda env, mask: difficulty)))
    curriculum.reset(mask(N, 2))
    assert env.log.flush() == logged


def test_a_term_sets_what_the_first_episodes_begin_with(env):
    class Wide(Level):
        def begin(self, env):
            env.width = 2.0

    CurriculumManager(env, Terms(level=TermCfg(Level), wide=TermCfg(Wide), quiet=TermCfg(quiet))).begin()
    assert env.width == 2.0
