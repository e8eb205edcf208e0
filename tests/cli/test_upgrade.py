"""A checkpoint of the first format in today's, under which all that knew the old file still knows it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from humoslope.cli import main
from humoslope.learning import checkpoint
from humoslope.learning.configuration import trained_cfg
from humoslope.learning.policy import read_provenance

TASK = "HumoSlope-Stage1-Unitree-G1"


@pytest.fixture
def old(untrained: Path, tmp_path: Path) -> Path:
    """The untrained checkpoint as the first version would have written it."""
    state = checkpoint.load(untrained)
    ancestor = {
        **dict.fromkeys(("path", "sha256"), "x"),
        **{"task": "Walk", "iter": 3, "total_steps": 7, "curriculum": {}, "ancestor": None},
    }
    former = {
        "format": 1,
        "task": TASK,
        "iter": 5,
        "total_steps": 11,
        "total_time": 1.0,
        "actor_state_dict": state["policy"]["weights"],
        **state["learner"],
        "env": state["env"],
        "rng": state["rng"] | {"cuda": []},
        "ancestor": ancestor,
    }
    path = tmp_path / "model_5.pt"
    torch.save(former, path)
    return path


def test_an_old_checkpoint_is_read_and_evaluated(old: Path) -> None:
    provenance = read_provenance(old)
    assert (provenance.iteration, provenance.total_steps) == (5, 11)
    assert provenance.parent is not None
    assert (provenance.parent.task, provenance.parent.iteration) == ("Walk", 3)
    assert main(["ramps", str(old), "--starts", "1", "--seconds", "0.1", "--grades", "0"]) == 0


def test_an_upgraded_one_holds_its_configuration_and_remembers_its_former_hash(old: Path, tmp_path: Path) -> None:
    new = tmp_path / "elsewhere" / "new.pt"
    options = "--preset cpu --env.num-envs 16 --env.actions.scale-factor 0.5"
    assert main(["upgrade", str(old), "--out", str(new), f"--options={options}"]) == 0
    state, before = checkpoint.load(new), checkpoint.load(old)
    cfg = trained_cfg(new, state)
    assert (cfg.env.num_envs, cfg.env.actions.scale_factor) == (16, 0.5)
    assert read_provenance(new).formerly == (checkpoint.digest(old),)
    assert state["policy"]["spec"] == before["policy"]["spec"]
    assert all(torch.equal(w, state["policy"]["weights"][n]) for n, w in before["policy"]["weights"].items())


def test_the_options_beside_an_old_checkpoint_count_unless_others_are_given(old: Path, tmp_path: Path) -> None:
    (old.parent / "options.txt").write_text("--preset cpu --env.actions.scale-factor 0.7")
    assert main(["upgrade", str(old), "--out", str(tmp_path / "new.pt")]) == 0
    assert trained_cfg(old, checkpoint.load(tmp_path / "new.pt")).env.actions.scale_factor == 0.7


def test_an_upgrade_may_replace_the_old_file_and_is_refused_the_second_time(
    old: Path, mistake: Callable[..., str]
) -> None:
    assert main(["upgrade", str(old), "--out", str(old), "--options=--preset cpu"]) == 0
    assert "has today's format already" in mistake("upgrade", str(old), "--out", str(old))


@pytest.mark.parametrize("name", ["stage1", "stage2", "url"])
def test_the_shipped_checkpoints_hold_their_configuration(name: str) -> None:
    path = Path(__file__).parents[2] / "experiments" / "checkpoints" / f"{name}.pt"
    state = checkpoint.load(path)
    cfg = trained_cfg(path, state)
    assert cfg.env.num_envs == 1024
    assert tuple(state["policy"]["spec"]["settings"]["hidden_dims"]) == (256, 128, 128)
