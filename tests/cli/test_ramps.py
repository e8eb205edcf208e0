"""`humoslope ramps`: the table, the file and the mistakes."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from humoslope.cli import main
from humoslope.learning import checkpoint

SHORT = ("--starts", "2", "--seconds", "3", "--grades", "0", "-20")


def walk(path: Path, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[dict[str, Any], str]:
    """The figures written for a checkpoint, and what was printed."""
    out = path.parent / "figures.json"
    assert main(["ramps", str(path), *SHORT, "--out", str(out), *options]) == 0
    return json.loads(out.read_text()), capsys.readouterr().out


def test_an_untrained_robot_falls_and_table_and_file_agree(
    untrained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Path(shutil.copy(untrained, tmp_path))
    figures, printed = walk(path, capsys)
    rows = {line.split()[0]: line.split() for line in printed.splitlines() if "/2" in line}
    assert list(rows) == ["-20", "0"]
    for ramp in figures["ramps"]:
        row = rows[f"{ramp['grade']:g}"]
        assert ramp["falls"]["count"] == ramp["falls"]["total"] == 2
        assert row[1] == "2/2"
        assert row[2] == "100.0"
        assert row[3] == f"{100 * ramp['falls']['low']:.1f}-100.0"
        assert row[-2] == f"{ramp['distance']:.2f}"
        touching = ramp["self_contact"]
        assert row[-1] == ("-" if touching is None else f"{100 * touching:.1f}")


def test_the_file_says_what_was_evaluated_and_how(
    untrained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Path(shutil.copy(untrained, tmp_path))
    figures, printed = walk(path, capsys)
    assert figures["checkpoint"]["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert figures["checkpoint"]["task"] == "HumoSlope-Stage1-Unitree-G1"
    assert figures["training_harness"] == {"used": True, "scale_at_checkpoint": 1.0}
    assert "training used the harness, which still had 100 % of its strength" in printed
    assert figures["physics"]["cone"] == "elliptic"
    assert "harness" not in figures["environment"]["events"]
    assert figures["command_line"].startswith(f"humoslope ramps {path} --starts 2")


def test_figures_land_beside_the_newest_checkpoint_of_a_run(
    untrained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in (0, 9, 10):
        shutil.copy(untrained, tmp_path / f"model_{number}.pt")
    assert main(["ramps", str(tmp_path), "--starts", "1", "--seconds", "0.1", "--grades", "0"]) == 0
    figures = json.loads((tmp_path / "model_10.ramps.json").read_text())
    assert figures["checkpoint"]["path"] == str(tmp_path / "model_10.pt")
    assert figures["ramps"][0]["speed"] is None  # nobody has settled in a tenth of a second
    assert figures["ramps"][0]["falls"]["count"] == 0


def test_a_policy_walks_as_it_was_trained_whatever_lies_beside_its_checkpoint(
    untrained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state = checkpoint.load(untrained)
    state["config"]["env"]["actions"]["scale_factor"] = 0.5
    path = tmp_path / "renamed.pt"
    checkpoint.save(path, state)
    (tmp_path / "options.txt").write_text("--preset cpu --env.actions.scale-factor 0.7")
    figures, printed = walk(path, capsys)
    assert figures["environment"]["actions"]["scale_factor"] == 0.5
    assert figures["physics"]["timestep"] == 0.005  # measured, not trained
    assert "has changed since in actions.scale_factor; the configuration in" in printed.replace("\n", " ")


def test_the_same_seed_gives_the_same_figures(
    untrained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Path(shutil.copy(untrained, tmp_path))
    first, second, other = (walk(path, capsys, "--seed", seed)[0]["ramps"] for seed in ("3", "3", "4"))
    assert first == second
    assert first != other


def test_what_is_no_checkpoint_is_said_in_one_sentence(mistake: Callable[..., str], tmp_path: Path) -> None:
    assert "does not exist" in mistake("ramps", str(tmp_path / "missing.pt"))
    (tmp_path / "text.pt").write_text("hello")
    assert "is damaged or truncated" in mistake("ramps", str(tmp_path / "text.pt"))
    torch.save({"weights": torch.zeros(3)}, tmp_path / "foreign.pt")
    assert "is not a HumoSlope checkpoint" in mistake("ramps", str(tmp_path / "foreign.pt"))
    (tmp_path / "run").mkdir()
    assert "holds no checkpoint" in mistake("ramps", str(tmp_path / "run"))


def test_a_checkpoint_of_a_task_that_is_not_registered_walks_by_its_own_configuration(
    untrained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "model_0.pt"
    checkpoint.save(path, checkpoint.load(untrained) | {"task": "HumoSlope-Stage1-Unitree-G2"})
    _, printed = walk(path, capsys)
    assert "Task 'HumoSlope-Stage1-Unitree-G2' is not registered here; the configuration in" in printed


def test_a_configuration_that_names_what_no_longer_exists_is_refused(
    mistake: Callable[..., str], untrained: Path, tmp_path: Path
) -> None:
    state = checkpoint.load(untrained)
    state["config"]["env"]["rewards"]["terms"]["zmp"]["func"] = {"$name": "humoslope.mdp.zmp:Gone"}
    checkpoint.save(tmp_path / "model_0.pt", state)
    said = mistake("ramps", str(tmp_path / "model_0.pt"))
    assert "model_0.pt': configuration: 'humoslope.mdp.zmp:Gone' does not exist any more" in said


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--grades", "90"), "grades is (90); of each, it must be between -60 and 60"),
        (("--starts", "0"), "starts is 0"),
        (("--timestep", "0.003"), "does not divide"),
        (("--out", "."), "is a folder"),
    ],
)
def test_an_impossible_option_is_said_in_one_sentence(
    mistake: Callable[..., str], untrained: Path, options: tuple[str, str], said: str
) -> None:
    assert said in mistake("ramps", str(untrained), *options)
