"""A checkpoint is whole or not there, and nothing in it is executed."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
import torch

from humoslope.errors import UserError
from humoslope.learning import checkpoint

STATE = {"actor_state_dict": {"weight": torch.ones(3)}, "task": "Walk", "iter": 4}


class Trap:
    """Code that a careless loader would run."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self):
        return Path.touch, (self.marker,)


def test_what_was_saved_is_loaded(tmp_path):
    checkpoint.save(tmp_path / "model_4.pt", STATE)
    state = checkpoint.load(tmp_path / "model_4.pt", "Walk")
    assert torch.equal(state["actor_state_dict"]["weight"], torch.ones(3))
    assert state["iter"] == 4


def test_a_crash_while_writing_leaves_the_old_file_and_no_other(tmp_path, monkeypatch):
    path = tmp_path / "model_4.pt"
    checkpoint.save(path, STATE)
    before = path.read_bytes()

    def crash(state: object, file: Path) -> None:
        file.write_bytes(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(torch, "save", crash)
    with pytest.raises(OSError, match="disk full"):
        checkpoint.save(path, STATE | {"iter": 5})
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_code_in_a_checkpoint_is_not_executed(tmp_path):
    path, marker = tmp_path / "model_0.pt", tmp_path / "was_here"
    torch.save(STATE | {"format": checkpoint.FORMAT, "trap": Trap(marker)}, path)
    with pytest.raises(UserError, match="no checkpoint at all"):
        checkpoint.load(path)
    assert not marker.exists()
    torch.load(path, weights_only=False)
    assert marker.exists(), "the trap works where nothing guards against it"


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_a_truncated_checkpoint_is_called_so(tmp_path, share):
    path = tmp_path / "model_0.pt"
    checkpoint.save(path, STATE)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(UserError, match="broken or truncated"):
        checkpoint.load(path)


@pytest.mark.parametrize(
    ("state", "task", "said"),
    [
        ({"weights": torch.ones(3)}, None, "is not a HumoSlope checkpoint"),
        (torch.ones(3), None, "is not a HumoSlope checkpoint"),
        (STATE | {"format": 999}, None, f"has format 999; this version reads format {checkpoint.FORMAT}"),
        (STATE | {"format": checkpoint.FORMAT}, "Run", "belongs to task 'Walk', not to 'Run'"),
    ],
)
def test_a_foreign_file_is_refused_for_what_it_is(tmp_path, state, task, said):
    torch.save(state, tmp_path / "model_0.pt")
    with pytest.raises(UserError, match=said):
        checkpoint.load(tmp_path / "model_0.pt", task)


def test_the_latest_checkpoint_is_the_one_of_the_highest_iteration(tmp_path):
    for name in ("model_9.pt", "model_100.pt", "model_99.pt", "model_.pt", "model_1000.tmp", ".model_500.pt.x.pt"):
        (tmp_path / name).touch()
    assert checkpoint.latest(tmp_path).name == "model_100.pt"


def test_all_random_sequences_continue_from_where_they_were_saved():
    def draw() -> list[float]:
        return [random.random(), random.gauss(0, 1), np.random.rand(), np.random.randn(), torch.rand(()).item()]  # noqa: NPY002

    draw()
    state = checkpoint.rng_state()
    expected = draw()
    draw()
    checkpoint.restore_rng(state)
    assert draw() == expected
