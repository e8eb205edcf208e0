"""The network against rsl_rl's own."""

from __future__ import annotations

import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization
from tensordict import TensorDict
from torch import Tensor

from humoslope.learning import networks
from humoslope.learning.networks import Network, Normalisation

SIZES = {"seen": 5, "known": 3}


def observations(batch: int = 40, seed: int = 0) -> TensorDict:
    """Columns of very different size and spread."""
    generator = torch.Generator().manual_seed(seed)

    def columns(d: int) -> Tensor:
        return torch.logspace(-2, 2, d) * torch.randn(batch, d, generator=generator) + torch.linspace(-3, 3, d)

    return TensorDict({name: columns(d) for name, d in SIZES.items()}, batch_size=[batch])


@pytest.mark.parametrize("groups", [["seen"], ["seen", "known"]])
@pytest.mark.parametrize("normalised", [True, False])
def test_it_answers_as_rsl_rls_network_does_with_the_same_weights(groups, normalised):
    theirs, ours = (
        cls(observations(), {"actor": groups}, "actor", 2, hidden_dims=[8], obs_normalization=normalised)
        for cls in (MLPModel, Network)
    )
    theirs.update_normalization(observations(seed=1))
    ours.load_state_dict(theirs.state_dict())
    for model in (theirs, ours):
        model.update_normalization(observations(seed=2))
    torch.testing.assert_close(ours(observations(seed=3)), theirs(observations(seed=3)))


@given(std=st.floats(0.0, 2.0), least=st.floats(0.0, 1.0))
@example(std=1e-4, least=0.0)
def test_no_observation_is_divided_by_less_than_the_least_deviation(std, least):
    normalisation = Normalisation(1, least)
    normalisation.update(torch.tensor([[-std], [std]]))  # about zero, where 32 bits hold the smallest deviation
    # The running variance begins at 1, from which its first update subtracts; that rounds it by up to 6e-8.
    divisor = 2.0 / normalisation(torch.tensor([[2.0]])).item()
    assert divisor == pytest.approx(max(std, least) + 0.01, rel=1e-4, abs=2.5e-4)


@given(seed=st.integers(0, 2**32 - 1), batches=st.lists(st.integers(2, 30), min_size=1, max_size=4))
def test_mean_and_deviation_are_learnt_as_by_rsl_rl(seed, batches):
    theirs, ours = EmpiricalNormalization(5), Normalisation(5)
    for k, batch in enumerate(batches):
        x = observations(batch, seed + k)["seen"]
        theirs.update(x)
        ours.update(x)
    assert ours.count == theirs.count
    torch.testing.assert_close(ours.mean, theirs.mean)
    torch.testing.assert_close(ours.std, theirs.std)


def test_a_batch_of_many_chunks_is_one_batch(monkeypatch):
    whole, chunks = Normalisation(5), Normalisation(5)
    whole.update(observations()["seen"])
    monkeypatch.setattr(networks, "CHUNK", 7)
    chunks.update(observations()["seen"])
    torch.testing.assert_close(chunks.std, whole.std)
