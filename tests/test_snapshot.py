"""A memory goes back into objects of the structure that it was taken from, and into no others."""

from __future__ import annotations

import copy
from types import SimpleNamespace

import pytest
import torch

from humoslope import snapshot


def lent(tensor: torch.Tensor) -> bool:
    return False


def roots() -> dict[str, object]:
    term = SimpleNamespace(last=torch.zeros(2), steps=3, since=None, row=[torch.ones(1)], name="of no account")
    return {"rewards": SimpleNamespace(terms={"zmp": term}, strength=torch.ones(1))}


def test_a_memory_fits_what_it_was_taken_from_whatever_has_been_forgotten_or_filled_since():
    memory = snapshot.take(roots(), [], lent)
    other = roots()
    term = other["rewards"].terms["zmp"]
    term.since, term.row = torch.ones(2), []
    snapshot.check(memory, other, [], lent)
    snapshot.put(memory, other, [])
    assert term.since is None
    assert [tensor.item() for tensor in term.row] == [1.0]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda rewards: rename(rewards.terms["zmp"], "last", "previous"), "rewards.terms.zmp has no last"),
        (lambda rewards: setattr(rewards.terms["zmp"], "age", 0.5), "nothing is known of rewards.terms.zmp.age"),
        (lambda rewards: rename(rewards, "terms", "calls"), "rewards.calls"),
        (lambda rewards: rewards.terms.clear(), "there is no rewards.terms.zmp"),
        (lambda rewards: delattr(rewards, "strength"), "rewards has no strength"),
    ],
)
def test_a_memory_of_other_code_is_refused(change, said):
    memory = snapshot.take(roots(), [], lent)
    other = copy.deepcopy(roots())
    change(other["rewards"])
    with pytest.raises(ValueError, match=said):
        snapshot.check(memory, other, [], lent)


def rename(thing: SimpleNamespace, before: str, after: str) -> None:
    setattr(thing, after, vars(thing).pop(before))
