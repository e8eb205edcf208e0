"""Intervals over seeds and trials have the width that theory gives them, and say when there is but one seed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import stdtrit

from humoslope.evaluation.report import seeds as module
from humoslope.evaluation.report.seeds import Estimate, Scores, Trials

RNG = np.random.default_rng


def normal(rng, n: int, m: int, between: float, within: float, mean: float = 0.0) -> list[Trials]:
    """n seeds of m trials each, whose means vary by `between`."""
    return [Trials.of(mean + between * rng.normal() + within * rng.normal(size=m)) for _ in range(n)]


def test_the_variance_of_the_draws_is_that_of_theory():
    trials = normal(RNG(0), 4, 30, 1.0, 2.0)
    scores = Scores(trials, "a")
    # Of seeds: (n - 1) / n of the usual one. Of trials in them: the mean of theirs.
    between = scores.scores.var() / 4
    within = np.mean([of.values.var() / 30 for of in trials]) / 4
    assert scores.drawn.mean(axis=1).var() == pytest.approx(between + within, rel=0.08)
    assert scores.drawn.mean() == pytest.approx(scores.scores.mean(), abs=0.05)


def test_one_seed_has_the_interval_of_its_trials():
    values = RNG(1).normal(2.0, 3.0, size=400)
    found = Scores([Trials.of(values)], "a").estimate()
    half = 1.96 * values.std() / math.sqrt(400)
    assert found.seeds == 1
    assert found.value == pytest.approx(values.mean())
    assert (found.low, found.high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.03)


def test_many_seeds_of_one_trial_have_students_interval():
    values = RNG(2).normal(size=300)
    found = Scores([Trials.of(np.array([value])) for value in values], "a").estimate()
    half = stdtrit(299, 0.975) * values.std(ddof=1) / math.sqrt(300)
    assert (found.low, found.high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.015)


def test_the_interval_of_three_seeds_holds_what_it_promises_and_differences_are_not_seen_where_none_are(monkeypatch):
    monkeypatch.setattr(module, "DRAWS", 300)
    rng, sets = RNG(3), 120
    held = plain = different = 0
    for i in range(sets):
        scores = Scores(normal(rng, 3, 10, 1.0, 0.3), f"a{i}")
        found = scores.estimate()
        held += found.low <= 0.0 <= found.high
        low, high = np.quantile(scores.drawn.mean(axis=1), (0.025, 0.975))
        plain += low <= 0.0 <= high
        different += scores.minus(Scores(normal(rng, 3, 10, 1.0, 0.3), f"b{i}")).separate
    assert held / sets > 0.88
    assert plain / sets < 0.85  # what the widening is for
    assert different / sets < 0.1


def one_trial_each(*values: float, name: str = "a") -> Scores:
    return Scores([Trials.of(np.array([value])) for value in values], name)


@pytest.mark.parametrize("other", [(0.0, 1.0, 2.0), (0.3, 1.9, 3.1)])
def test_a_difference_of_few_seeds_has_welchs_interval(other, monkeypatch):
    """The side that varies more has nearly all of the variance, so the freedom of both is little more than its own."""
    monkeypatch.setattr(module, "DRAWS", 50_000)
    first = np.array([0.0, 4.0, 8.0])
    mine, theirs = first.var(ddof=1) / 3, np.var(other, ddof=1) / 3
    freedom = (mine + theirs) ** 2 / (mine**2 / 2 + theirs**2 / 2)  # 2.25 and 2.5; both have 4 together
    half = stdtrit(freedom, 0.975) * math.sqrt(mine + theirs)
    wide, narrow = one_trial_each(*first), one_trial_each(*other, name="b")
    for found in (wide.minus(narrow), narrow.minus(wide)):
        # Means of three drawn from three are few different ones, so that the draws are only nearly normal.
        assert found.high - found.value == pytest.approx(half, rel=0.05)
        assert found.value - found.low == pytest.approx(half, rel=0.05)


def test_a_difference_that_is_there_is_seen():
    rng = RNG(4)
    better, worse = normal(rng, 3, 50, 0.05, 0.3, mean=1.0), normal(rng, 3, 50, 0.05, 0.3)
    found = Scores(better, "better").minus(Scores(worse, "worse"))
    assert found.separate
    assert found.low < 1.0 < found.high
    back = Scores(worse, "worse").minus(Scores(better, "better"))
    assert (back.value, back.low, back.high) == pytest.approx((-found.value, -found.high, -found.low))


def test_a_single_seed_is_never_called_different():
    rng = RNG(5)
    found = Scores(normal(rng, 3, 50, 0.0, 0.1, mean=5.0), "a").minus(Scores(normal(rng, 1, 50, 0.0, 0.1), "b"))
    assert found.seeds == 1
    assert found.low > 0.0
    assert not found.separate


def test_shares_that_are_all_or_nothing_are_not_certain():
    all_of_them = [Trials.of(np.ones(32), shares=True)] * 3
    found = Scores(all_of_them, "a").estimate(0.0, 1.0)
    assert (found.value, found.high) == (1.0, 1.0)
    assert 0.8 < found.low < 0.999
    # One seed: Jeffreys' interval.
    one = Scores(all_of_them[:1], "a").estimate(0.0, 1.0)
    assert one.low == pytest.approx(0.923, abs=0.012)
    alike = Scores(all_of_them, "a").minus(Scores(all_of_them, "b"))
    assert alike.low < 0.0 < alike.high
    none_of_them = Scores([Trials.of(np.zeros(32), shares=True)] * 3, "c")
    assert Scores(all_of_them, "a").minus(none_of_them).separate


def test_a_quotient_of_sums_weighs_trials_by_their_weights():
    trials = Trials.of(np.array([1.0, 9.0, np.nan]), np.array([1.0, 3.0, 4.0]))
    assert trials.score == pytest.approx(2.5)
    scores = Scores([trials], "a")
    assert set(np.round(scores.drawn[:, 0], 6)) == {1.0, 2.5, 3.0}


def test_nothing_to_draw_from_has_no_interval():
    alone = Scores([Trials.of(np.array([3.0]))], "a")
    assert alone.estimate() == Estimate(3.0, None, None, 1)
    found = alone.minus(Scores(normal(RNG(6), 3, 5, 1.0, 1.0), "b"))
    assert (found.low, found.high, found.separate) == (None, None, False)
    assert Trials.of(np.array([np.nan])) is None
    assert Trials.of(np.array([])) is None


def test_the_interquartile_mean_leaves_out_a_quarter_at_either_end():
    scores = one_trial_each(0.0, 1.0, 2.0, 100.0)
    found = scores.interquartile_mean()
    assert found.value == 1.5
    assert found.low < 1.5 < found.high
    few = one_trial_each(0.0, 1.0, 5.0)
    assert few.interquartile_mean() == few.estimate()


def test_the_interval_of_an_interquartile_mean_has_the_freedom_of_the_seeds_that_are_left():
    scores = one_trial_each(0.0, 1.0, 3.0, 7.0)
    found = scores.interquartile_mean()
    low, high = np.quantile(np.sort(scores.drawn, axis=1)[:, 1:3].mean(axis=1), (0.025, 0.975))
    # Two of four are left: Student's quantile with one degree is 12.7.
    wider = math.sqrt(4.0 / 3.0) * stdtrit(1, 0.975) / 1.96
    assert found.high - found.value == pytest.approx(wider * (high - found.value), rel=1e-3)
    assert found.value - found.low == pytest.approx(wider * (found.value - low), rel=1e-3)


def test_draws_depend_on_the_name_alone():
    trials = normal(RNG(7), 3, 5, 1.0, 1.0)
    first, again, other = (Scores(trials, name).estimate() for name in ("a", "a", "b"))
    assert first == again
    assert first != other


@given(
    values=st.lists(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=5), min_size=1, max_size=4),
    shift=st.floats(-100.0, 100.0),
)
def test_an_interval_holds_its_figure_and_moves_with_it(values, shift):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "DRAWS", 50)
        found = Scores([Trials.of(np.array(of)) for of in values], "a").estimate()
        moved = Scores([Trials.of(np.array(of) + shift) for of in values], "a").estimate()
    assert moved.value == pytest.approx(found.value + shift, abs=1e-6)
    if found.low is not None:
        assert found.low <= found.value + 1e-9
        assert found.value - 1e-9 <= found.high
        assert moved.low == pytest.approx(found.low + shift, rel=1e-6, abs=1e-5)
