"""Means that gather on the device."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from humoslope.managers import Log


@pytest.fixture
def log() -> Log:
    return Log(torch.device("cpu"))


def test_a_mean_runs_over_all_envs_and_all_additions(log):
    log.add("speed", torch.tensor([1.0, 2.0]))
    log.add("speed", torch.tensor([3.0, 6.0]))
    assert log.flush() == {"speed": 3.0}


def test_only_envs_in_the_mask_count(log):
    log.add("length", torch.tensor([10, 20, 30]), torch.tensor([True, False, True]))
    log.add("length", torch.tensor([90, 90, 90]), torch.tensor([False, False, False]))
    assert log.flush() == {"length": 20.0}


def test_a_name_to_which_nothing_was_added_is_left_out(log):
    log.add("length", torch.tensor([1.0]), torch.tensor([False]))
    log.add("scale", torch.tensor(0.5))
    assert log.flush() == {"scale": 0.5}


def test_booleans_give_shares(log):
    log.add("fallen", torch.tensor([True, False, False, False]))
    assert log.flush() == {"fallen": 0.25}


def test_a_flush_starts_anew(log):
    log.add("speed", torch.tensor([1.0]))
    log.flush()
    assert log.flush() == {}
    log.add("speed", torch.tensor([5.0]))
    assert log.flush() == {"speed": 5.0}


@given(seed=st.integers(0, 2**32 - 1), additions=st.integers(1, 80))
def test_the_mean_is_numpys_mean_of_what_the_masks_let_through(seed, additions):
    log, rng, seen = Log(torch.device("cpu")), np.random.default_rng(seed), []
    for _ in range(additions):
        values, mask = rng.normal(size=7), rng.random(7) < 0.5
        log.add("x", torch.tensor(values), torch.tensor(mask))
        seen.extend(values[mask])
    assert log.flush().get("x", "nothing") == (pytest.approx(np.mean(seen), abs=1e-5) if seen else "nothing")
