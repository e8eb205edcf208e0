"""A checkpoint is whole or not there, and nothing in it is executed."""

from __future__ import annotations

import errno
import random
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.learning import checkpoint
from humoslope.learning.rng import restore_rng, rng_state
from humoslope.seal import sealed
from tests.learning.states import checkpoint_state

STATE = checkpoint_state()
WHOLE = STATE | {"format": checkpoint.FORMAT}

CPU = torch.device("cpu")


class Trap:
    """Code that a careless loader would run."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self):
        return Path.touch, (self.marker,)


def test_what_was_saved_is_loaded(tmp_path):
    checkpoint.save(tmp_path / "model_4.pt", STATE)
    state = checkpoint.load(tmp_path / "model_4.pt", "Walk")
    assert torch.equal(state["policy"]["weights"]["weight"], torch.ones(3))
    assert state["iteration"] == 4


def test_a_crash_while_writing_leaves_the_old_file_and_no_other(tmp_path, monkeypatch):
    path = tmp_path / "model_4.pt"
    checkpoint.save(path, STATE)
    before = path.read_bytes()

    write = Path.write_bytes

    def crash(self: Path, content: bytes) -> int:
        write(self, content[: len(content) // 2])
        raise OSError(errno.ENOSPC, "disk full")

    monkeypatch.setattr(Path, "write_bytes", crash)
    with pytest.raises(UserError, match=r"cannot write '.*model_4.pt': disk full; the file that was there is whole\.$"):
        checkpoint.save(path, STATE | {"iteration": 5})
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_code_in_a_checkpoint_is_not_executed(tmp_path):
    path, marker = tmp_path / "model_0.pt", tmp_path / "was_here"
    torch.save(WHOLE | {"trap": Trap(marker)}, path)
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
    with pytest.raises(UserError, match="damaged or truncated"):
        checkpoint.load(path)


@pytest.mark.parametrize(
    ("state", "task", "said"),
    [
        ({"weights": torch.ones(3)}, None, "is not a HumoSlope checkpoint"),
        (torch.ones(3), None, "is not a HumoSlope checkpoint"),
        (
            STATE | {"format": 999},
            None,
            "has format 999; this version reads format 2 and older",
        ),
    ],
)
def test_a_foreign_file_is_refused_for_what_it_is(tmp_path, state, task, said):
    torch.save(state, tmp_path / "model_0.pt")
    with pytest.raises(UserError, match=said):
        checkpoint.load(tmp_path / "model_0.pt", task)


def test_a_checkpoint_of_another_task_is_refused(tmp_path):
    checkpoint.save(tmp_path / "model_0.pt", STATE)
    with pytest.raises(UserError, match="belongs to task 'Walk', not to 'Run'"):
        checkpoint.load(tmp_path / "model_0.pt", "Run")


@given(place=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_anywhere_is_noticed(sealed_file, place, bit):
    content = bytearray(sealed_file.read_bytes())
    content[int(place * len(content))] ^= 1 << bit
    damaged = sealed_file.with_name("damaged.pt")
    damaged.write_bytes(bytes(content))
    with pytest.raises(UserError, match=r"damaged or truncated|is not a HumoSlope checkpoint|has format"):
        checkpoint.load(damaged)


@pytest.fixture(scope="module")
def sealed_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("checkpoint") / "model_4.pt"
    checkpoint.save(path, STATE)
    return path


def test_a_file_that_lost_its_checksum_is_refused(tmp_path):
    torch.save(WHOLE, tmp_path / "model_0.pt")
    with pytest.raises(UserError, match="damaged or truncated"):
        checkpoint.load(tmp_path / "model_0.pt")


def test_a_renamed_and_moved_checkpoint_is_the_same(tmp_path, sealed_file):
    path = tmp_path / "elsewhere" / "x.pt"
    path.parent.mkdir()
    path.write_bytes(sealed_file.read_bytes())
    assert checkpoint.load(path)["iteration"] == 4


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("part", ["policy", "learner"])
def test_weights_that_are_not_finite_are_neither_written_nor_read(tmp_path, part, value):
    weights = {part: {"spec": {}, "weights": {"layer": torch.tensor([1.0, value])}}}
    path = tmp_path / "model_0.pt"
    with pytest.raises(UserError, match=rf"is not written: {part}\.weights\.layer holds values that are not finite"):
        checkpoint.save(path, STATE | weights)
    assert not path.exists()
    torch.save(WHOLE | weights, path)
    path.write_bytes(sealed(path.read_bytes()))
    with pytest.raises(UserError, match=rf"cannot be used: {part}\.weights\.layer holds values that are not finite"):
        checkpoint.load(path)


def test_the_latest_checkpoint_is_the_one_of_the_highest_iteration(tmp_path):
    for name in ("model_9.pt", "model_100.pt", "model_99.pt", "model_.pt", "model_1000.tmp", ".model_500.pt.x.pt"):
        (tmp_path / name).touch()
    assert checkpoint.latest(tmp_path).name == "model_100.pt"


def test_all_random_sequences_continue_from_where_they_were_saved():
    def draw() -> list[float]:
        return [random.random(), random.gauss(0, 1), np.random.rand(), np.random.randn(), torch.rand(()).item()]  # noqa: NPY002

    draw()
    state = rng_state(CPU)
    expected = draw()
    draw()
    restore_rng(state, CPU)
    assert draw() == expected


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"iteration": -5}, "iteration is -5; it must be 0 or more"),
        ({"total_time": float("nan")}, "total_time is nan; it must be 0 or more"),
        ({"iteration": "4"}, "has no proper 'iteration'"),
        ({"env": {"curriculum": {}}}, "has no proper 'env.level'"),
        ({"env": {"curriculum": {}, "level": torch.zeros(2, 2, dtype=torch.int64)}}, "has no proper 'env.level'"),
        ({"env": {"curriculum": {}, "level": torch.tensor([-5])}}, "has no proper state of the environment"),
        ({"policy": {"weights": {}}}, "has no proper 'policy'"),
        ({"rng": None}, "has no proper 'rng'"),
    ],
)
def test_a_whole_file_with_impossible_content_is_refused_in_a_sentence(tmp_path, change, said):
    path = tmp_path / "model_4.pt"
    checkpoint.save(path, STATE | change)
    with pytest.raises(UserError, match=said) as caught:
        checkpoint.load(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("entry", sorted(STATE))
def test_a_checkpoint_that_lacks_an_entry_is_refused(tmp_path, entry):
    checkpoint.save(tmp_path / "model_4.pt", {name: value for name, value in STATE.items() if name != entry})
    with pytest.raises(UserError, match=f"no proper '{entry}'|is not a HumoSlope checkpoint"):
        checkpoint.load(tmp_path / "model_4.pt")
