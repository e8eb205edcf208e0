"""Distributions over returns are moved, discounted and projected as by hand, and actions stay within their bound."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from humoslope.learning.fasttd3.networks import Critics, Support
from humoslope.learning.policy import PolicySpec

rewards = st.floats(-4.0, 4.0, width=32)
discounts = st.floats(0.0, 1.0, width=32)
supports = st.tuples(st.integers(2, 9), st.floats(-3.0, 0.0, width=32), st.floats(0.5, 3.0, width=32))


def by_hand(atoms: list[float], probabilities: list[float], reward: float, discount: float) -> list[float]:
    """Each atom's mass, moved and split between its two neighbours."""
    projected = [0.0] * len(atoms)
    gap = atoms[1] - atoms[0]
    for atom, mass in zip(atoms, probabilities, strict=True):
        moved = min(max(reward + discount * atom, atoms[0]), atoms[-1])
        for i, other in enumerate(atoms):
            projected[i] += mass * max(0.0, 1.0 - abs(moved - other) / gap)
    return projected


@given(supports, st.lists(st.tuples(rewards, discounts), min_size=1, max_size=4), st.integers(0, 1000))
def test_the_projection_is_that_by_hand(
    sizes: tuple[int, float, float], moves: list[tuple[float, float]], seed: int
) -> None:
    num_atoms, low, width = sizes
    support = Support.of(low, low + width, num_atoms, "cpu")
    generator = torch.Generator().manual_seed(seed)
    probabilities = torch.rand(2, len(moves), num_atoms, generator=generator).softmax(dim=-1)
    reward, discount = torch.tensor(moves).T
    projected = support.project(probabilities, reward, discount)
    for critic in range(2):
        for row, (r, d) in enumerate(moves):
            expected = by_hand(support.atoms.tolist(), probabilities[critic, row].tolist(), r, d)
            assert projected[critic, row].tolist() == pytest.approx(expected, abs=2e-5)


@given(supports, rewards, discounts)
def test_no_mass_is_lost_or_counted_twice(sizes: tuple[int, float, float], reward: float, discount: float) -> None:
    num_atoms, low, width = sizes
    support = Support.of(low, low + width, num_atoms, "cpu")
    each = torch.eye(num_atoms)  # all mass at one atom, for every atom
    moved = support.project(each, torch.full((num_atoms,), reward), torch.full((num_atoms,), discount))
    assert (moved >= -1e-6).all()
    assert moved.sum(dim=1).tolist() == pytest.approx([1.0] * num_atoms, abs=1e-5)


@pytest.mark.parametrize("atom", [0, 2, 4])
def test_mass_that_comes_to_lie_on_an_atom_stays_whole(atom: int) -> None:
    support = Support.of(-2.0, 2.0, 5, "cpu")
    reward = support.atoms[atom : atom + 1]
    moved = support.project(torch.full((1, 5), 0.2), reward, torch.zeros(1))
    assert moved[0].tolist() == pytest.approx(torch.eye(5)[atom].tolist())


def test_the_mean_is_kept_inside_the_support_and_what_leaves_it_ends_at_its_ends() -> None:
    support = Support.of(-10.0, 10.0, 21, "cpu")
    probabilities = torch.rand(3, 21).softmax(dim=-1)
    inside = support.project(probabilities, torch.tensor([0.3, -0.2, 1.0]), torch.full((3,), 0.8))
    expected = torch.tensor([0.3, -0.2, 1.0]) + 0.8 * support.mean(probabilities)
    assert support.mean(inside).tolist() == pytest.approx(expected.tolist(), abs=1e-5)
    assert support.end_mass(inside).item() == pytest.approx(0.0, abs=1e-6)
    outside = support.project(probabilities, torch.tensor([30.0, -30.0, 30.0]), torch.full((3,), 0.8))
    assert support.mean(outside).tolist() == pytest.approx([10.0, -10.0, 10.0])
    assert support.end_mass(outside).item() == pytest.approx(1.0)


def test_the_two_critics_differ() -> None:
    first, second = Critics(3, 2, (8, 4), 5)(torch.rand(6, 3), torch.rand(6, 2))
    assert first.shape == (6, 5)
    assert not torch.equal(first, second)


def test_actions_begin_at_zero_and_never_leave_their_bound() -> None:
    settings = {"bound": 3.0, "hidden_dims": [8, 4], "activation": "relu", "obs_normalization": True}
    actor = PolicySpec("tanh-mlp", ("actor",), ((4,),), 2, settings).build("cpu")
    assert actor({"actor": torch.randn(5, 4)}).abs().max() < 0.3
    with torch.no_grad():
        actor.mlp[-3].weight.copy_(torch.tensor([[1e4], [-1e4]]).expand(2, 4))  # on what ReLU leaves, 0 or more
    action = actor({"actor": torch.randn(500, 4)})
    assert action.abs().max().item() == pytest.approx(3.0)
    assert action.min().item() == pytest.approx(-3.0)
