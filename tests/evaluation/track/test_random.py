"""A trial's random numbers are its own."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st

from humoslope.evaluation.track.random import trial_keys, uniform

WORD = (1 << 64) - 1
WORDS = st.integers(-(2**63), 2**63 - 1)


def splitmix64(seed: int, count: int) -> list[int]:
    """The first words of the sequence, one after the other, in Python's integers."""
    words, state = [], seed & WORD
    for _ in range(count):
        state = (state + 0x9E3779B97F4A7C15) & WORD
        z = state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & WORD
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & WORD
        words.append(z ^ (z >> 31))
    return words


def test_the_sequence_is_the_published_one() -> None:
    published = [6457827717110365317, 3203168211198807973, 9817491932198370423]
    assert splitmix64(1234567, 3) == published
    drawn = uniform(torch.tensor([1234567]), torch.tensor([0]), 3)[0]
    assert (drawn * 2**24).tolist() == [word >> 40 for word in published]


@given(key=WORDS, step=st.integers(0, 7000), columns=st.integers(1, 8))
def test_any_part_of_a_sequence_can_be_had_without_the_rest(key: int, step: int, columns: int) -> None:
    drawn = uniform(torch.tensor([key]), torch.tensor([step]), columns)[0]
    whole = splitmix64(key + step * columns * 0x9E3779B97F4A7C15, columns)
    assert (drawn.double() * 2**24).tolist() == [word >> 40 for word in whole]


def test_numbers_are_uniform_and_worlds_and_steps_do_not_share_any() -> None:
    keys = trial_keys(0, 30.0, 0.3, 50)[:, 0]
    drawn = torch.cat([uniform(keys, torch.full((50,), step), 96) for step in range(20)])
    assert drawn.min() >= 0.0
    assert drawn.max() < 1.0
    assert abs(drawn.mean() - 0.5) < 0.005
    assert abs(drawn.std() - 12**-0.5) < 0.005
    assert torch.histc(drawn, 10, 0.0, 1.0).std() < 0.02 * drawn.numel() / 10
    correlation = torch.corrcoef(drawn)
    assert (correlation - torch.eye(len(correlation))).abs().max() < 0.6


def test_a_world_draws_the_same_whoever_is_beside_it() -> None:
    keys, steps = trial_keys(0, 0.0, 0.6, 8)[:, 0], torch.arange(8)
    together = uniform(keys, steps, 5)
    assert torch.equal(together[3:5], uniform(keys[3:5], steps[3:5], 5))


def test_keys_differ_between_trials_cells_and_seeds_and_more_trials_begin_with_fewer() -> None:
    some = trial_keys(0, 10.0, 0.3, 20)
    assert torch.equal(trial_keys(0, 10.0, 0.3, 5), some[:5])
    others = [trial_keys(1, 10.0, 0.3, 20), trial_keys(0, 11.0, 0.3, 20), trial_keys(0, 10.0, 0.6, 20)]
    assert len(torch.cat([some, *others]).unique()) == 4 * 20 * 2
