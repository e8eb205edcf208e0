"""Named terms, and how they are bound to the environment."""

from __future__ import annotations

import copy
import pickle

import pytest
import torch

from humoslope.errors import UserError
from humoslope.managers import RewardTermCfg, StatefulTerm, TermCfg, Terms
from humoslope.managers.terms import StatefulTerms, bind


def height(env, target, scale=2.0):
    return scale * (env.height - target)


class Counter(StatefulTerm):
    """Counts its calls."""

    def __init__(self, env, step=1):
        self.count = env.zeros()
        self.step = step

    def __call__(self, env):
        self.count = self.count + self.step
        return self.count

    def reset(self, mask):
        self.count = self.count.masked_fill(mask, 0.0)


@pytest.fixture
def terms():
    return Terms(alive=RewardTermCfg(height, weight=0.5), swing=RewardTermCfg(height), zmp=RewardTermCfg(height))


# Terms


def test_a_mistyped_field_of_a_term_is_named_with_the_nearest_match(terms):
    with pytest.raises(UserError, match="RewardTermCfg field 'wieght' does not exist; did you mean 'weight'"):
        terms.alive.wieght = 2.0


def test_terms_are_read_and_changed_by_name_and_keep_their_order(terms):
    terms.alive.weight = 0.2
    assert terms.alive.weight == 0.2
    assert [name for name, _ in terms.items()] == ["alive", "swing", "zmp"]
    assert len(terms) == 3
    assert "swing" in terms


def test_assigning_none_takes_a_term_away(terms):
    terms.swing = None
    assert [name for name, _ in terms.items()] == ["alive", "zmp"]
    assert "swing" not in terms


def test_deleting_takes_a_term_away(terms):
    del terms.alive
    assert "alive" not in terms


def test_joining_and_updating_keep_the_rules_of_setting_a_term(terms):
    more = {"swing": None, "pitch": RewardTermCfg(height, weight=2.0)}
    joined = terms | more
    assert isinstance(joined, Terms)
    assert list(joined) == ["alive", "zmp", "pitch"]
    assert list(terms) == ["alive", "swing", "zmp"]
    terms |= more
    assert terms == joined
    terms.update(alive=None)
    assert list(terms) == ["zmp", "pitch"]
    with pytest.raises(UserError, match="a term cannot be named 'items'"):
        terms.update({"items": RewardTermCfg(height)})


def test_a_new_term_goes_to_the_end(terms):
    terms.pitch = RewardTermCfg(height)
    assert [name for name, _ in terms.items()][-1] == "pitch"


def test_reading_a_mistyped_name_tells_the_nearest_one(terms):
    with pytest.raises(UserError, match="term 'swinng' does not exist; did you mean 'swing'"):
        terms.swinng.weight = 2.0


def test_taking_away_a_mistyped_name_tells_the_nearest_one(terms):
    with pytest.raises(UserError, match="did you mean 'alive'"):
        terms.alvie = None
    with pytest.raises(UserError, match="did you mean 'alive'"):
        del terms.alvie


def test_terms_can_be_copied_deeply_and_pickled(terms):
    for copied in (copy.deepcopy(terms), pickle.loads(pickle.dumps(terms))):
        copied.alive.weight = 7.0
        copied.swing = None
        assert terms.alive.weight == 0.5
        assert "swing" in terms


def test_terms_are_a_dictionary_with_the_same_rules(terms):
    assert dict(terms) == {"alive": terms.alive, "swing": terms.swing, "zmp": terms["zmp"]}
    terms["pitch"] = RewardTermCfg(height)
    assert terms.pitch is terms["pitch"]
    terms["pitch"] = None
    assert "pitch" not in terms
    with pytest.raises(UserError, match="did you mean 'swing'"):
        terms["swinng"] = None


@pytest.mark.parametrize("name", ["items", "get", "ramp-up", "2nd", "__class__"])
def test_a_name_that_could_not_be_read_as_an_attribute_is_refused(terms, name):
    with pytest.raises(UserError, match=f"cannot be named '{name}'"):
        terms[name] = RewardTermCfg(height)
    with pytest.raises(UserError, match=f"cannot be named '{name}'"):
        Terms(**{name: RewardTermCfg(height)})


# Binding


def test_a_function_is_called_with_its_parameters_filled_in(make_env):
    call = bind("reward", "height", TermCfg(height, {"target": 1.0}), make_env(height=torch.full((4,), 3.0)))
    assert call(make_env(height=torch.full((4,), 3.0))).tolist() == [4.0] * 4


def test_an_event_gets_the_mask_too(make_env, mask):
    def event(env, mask, amount):
        return mask * amount

    call = bind("event", "push", TermCfg(event, {"amount": 2.0}), make_env(), ("env", "mask"))
    assert call(make_env(), mask(4, 1)).tolist() == [0.0, 2.0, 0.0, 0.0]


def test_an_unknown_parameter_names_the_term_and_the_nearest_parameter(make_env):
    with pytest.raises(UserError, match=r"reward 'height': parameter 'taregt' does not exist; did you mean 'target'"):
        bind("reward", "height", TermCfg(height, {"taregt": 1.0}), make_env())


@pytest.mark.parametrize("value", [float("nan"), float("inf"), (0.0, float("nan")), {"low": [float("-inf")]}])
def test_a_parameter_that_is_not_finite_is_named(make_env, value):
    with pytest.raises(UserError, match=r"reward 'height': target is .*; it must be finite"):
        bind("reward", "height", TermCfg(height, {"target": value}), make_env())


def test_the_environment_is_no_parameter(make_env):
    with pytest.raises(UserError, match="parameter 'env' does not exist"):
        bind("reward", "height", TermCfg(height, {"env": None, "target": 1.0}), make_env())


def test_a_missing_parameter_is_named(make_env):
    with pytest.raises(UserError, match="reward 'height': parameter 'target' of height has no value"):
        bind("reward", "height", TermCfg(height), make_env())


def test_a_class_is_constructed_with_its_parameters(make_env):
    env = make_env()
    counter = bind("reward", "count", TermCfg(Counter, {"step": 3}), env)
    counter(env)
    assert counter(env).tolist() == [6.0] * 4


def test_the_parameters_of_a_class_are_checked(make_env):
    with pytest.raises(UserError, match="reward 'count': parameter 'stepp' does not exist; did you mean 'step'"):
        bind("reward", "count", TermCfg(Counter, {"stepp": 3}), make_env())


def test_a_class_that_is_no_stateful_term_is_refused(make_env):
    class Memory:
        def __init__(self, env):
            pass

    with pytest.raises(
        UserError, match=r"reward 'memory': class Memory must derive from StatefulTerm and define reset"
    ):
        bind("reward", "memory", TermCfg(Memory), make_env())


def test_a_stateful_term_that_cannot_be_reset_is_refused(make_env):
    class Leaky(StatefulTerm):
        def __init__(self, env):
            pass

        def __call__(self, env):
            return env.zeros()

    with pytest.raises(UserError, match=r"reward 'leaky': class Leaky must derive from StatefulTerm and define reset"):
        bind("reward", "leaky", TermCfg(Leaky), make_env())


def test_only_stateful_terms_are_reset_together(make_env, mask):
    env, kept = make_env(), StatefulTerms()
    counters = [kept.keep(bind("reward", "count", TermCfg(Counter), env)) for _ in range(2)]
    kept.keep(bind("reward", "height", TermCfg(height, {"target": 1.0}), env))
    for counter in counters:
        counter(env)
    kept.reset(mask(4, 0, 2))
    assert [counter.count.tolist() for counter in counters] == [[0.0, 1.0, 0.0, 1.0]] * 2
