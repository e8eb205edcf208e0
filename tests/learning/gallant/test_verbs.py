"""Gallant is trained, stopped, resumed, measured, recorded and exported by the same verbs as every other task."""

from __future__ import annotations

import json
import os
import shutil
import signal
from pathlib import Path

import pytest
import torch

from humoslope.cli import main
from humoslope.deploy.contract import FILE
from humoslope.evaluation.report.curve import read_curves
from humoslope.evaluation.report.results import read_results
from humoslope.learning import checkpoint
from humoslope.learning.logger import ProgressLine
from humoslope.learning.policy import read_provenance, read_spec

TASK = "Gallant-Unitree-G1"
TINY = [
    *("--preset", "cpu", "--env.num-envs", "8", "--env.sim.device", "cpu"),
    *("--env.scene.terrain.levels", "3", "--env.scene.terrain.num-columns", "9"),
    *("--agent.num-steps-per-env", "4", "--agent.save-interval", "1", "--agent.num-mini-batches", "2"),
    *("--agent.hidden-dims", "16", "--agent.proprioception-dim", "16", "--agent.voxel-dim", "8"),
    "--agent.no-mixed-precision",
]
REDUCED = "reduced grid 16 x 16 x 20 of 10 cm"

pytestmark = pytest.mark.usefixtures("shared_operators")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two iterations."""
    folder = tmp_path_factory.mktemp("gallant") / "run"
    assert main(["train", TASK, "--run-dir", str(folder), *TINY, "--agent.max-iterations", "2"]) == 0
    return folder


def test_it_learns_and_logs(run: Path) -> None:
    curves = read_curves(run)
    assert len(curves["Loss/value"]) == 2
    assert max(curves["Loss/learning_rate"].values()) <= 5e-4 * (1.0 + 1e-6)  # curves are in single precision
    first, second = (checkpoint.load(run / f"model_{i}.pt")["policy"]["weights"] for i in range(2))
    for name in ("voxels.1.weight", "ground.0.weight", "proprioception.0.weight", "mlp.0.weight"):
        assert not torch.equal(first[name], second[name]), name


def test_a_signal_stops_it_and_it_resumes_and_says_again_that_its_grid_is_reduced(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shutil.copytree(run, tmp_path / "run")
    shown = ProgressLine.show

    def interrupt(self: ProgressLine, iteration: int, values: dict[str, float]) -> None:
        shown(self, iteration, values)
        os.kill(os.getpid(), signal.SIGTERM)

    with monkeypatch.context() as patch:
        patch.setattr(ProgressLine, "show", interrupt)
        assert main(["train", TASK, "--resume", str(folder), "--agent.max-iterations", "9"]) == 143
    assert checkpoint.latest(folder).name == "model_2.pt"
    said = " ".join(capsys.readouterr().out.split())
    assert f"The voxels are a {REDUCED} (of the preset 'cpu'): not Gallant's own." in said
    assert "Its episodes go on where they were." in said
    assert main(["train", TASK, "--resume", str(folder), "--agent.max-iterations", "4"]) == 0
    assert checkpoint.load(folder / "model_3.pt", TASK)["total_steps"] == 128


def test_a_resumed_run_is_the_one_that_was_never_stopped(run: Path, tmp_path: Path) -> None:
    stopped, whole = shutil.copytree(run, tmp_path / "stopped"), tmp_path / "whole"
    assert main(["train", TASK, "--resume", str(stopped), "--agent.max-iterations", "3"]) == 0
    assert main(["train", TASK, "--run-dir", str(whole), *TINY, "--agent.max-iterations", "3"]) == 0
    one, other = (checkpoint.load(folder / "model_2.pt")["policy"]["weights"] for folder in (stopped, whole))
    assert all(torch.equal(one[name], other[name]) for name in one)


def test_results_are_called_by_the_reduced_grid(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert read_spec(run / "model_1.pt").variant == REDUCED
    assert read_provenance(run / "model_1.pt").name == f"{TASK}, {REDUCED}"
    assert main(["evaluate", str(run), "--trials", "1", "--grades", "0", "--timeout-s", "0.1"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"{TASK}, {REDUCED}, iteration 1" in said
    assert "has changed since" not in said
    file = str(run / "model_1.heldout.json")
    assert [r.name for r in read_results([file])] == [f"{TASK}, {REDUCED}"]
    named = read_results([f"Gallant (re-implemented)={file}"])
    assert [r.name for r in named] == [f"Gallant (re-implemented), {REDUCED}"]
    assert REDUCED in (run / "model_1.heldout.md").read_text()


def test_it_is_measured_on_ramps_and_recorded(run: Path) -> None:
    assert main(["ramps", str(run), "--starts", "1", "--seconds", "0.1", "--grades", "0", "10"]) == 0
    assert json.loads((run / "model_1.ramps.json").read_text())["checkpoint"]["variant"] == REDUCED
    assert main(["record", str(run), "--terrain", "ramp-up", "--grade", "5", "--seconds", "0.1"]) == 0


def test_a_goal_cannot_be_a_yaw_rate(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ramps", str(run), "--starts", "1", "--seconds", "0.1", "--grades", "0", "--yaw-rate", "0.2"]) == 2
    assert "a goal always steers and cannot ask for a yaw rate" in " ".join(capsys.readouterr().err.split())


def test_it_is_exported_and_play_says_in_a_sentence_what_it_cannot_compute(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(run)]) == 0
    folder = run / "model_1.export"
    contract = json.loads((folder / FILE).read_text())
    custom = [t["name"] for group in contract["observations"] for t in group["terms"] if t["quantity"] == "custom"]
    assert custom == ["goal", "columns"]
    assert [end["shape"] for end in contract["network"]["inputs"]] == [[1, 4], [1, 384], [1, 116], [1, 256]]
    capsys.readouterr()
    assert main(["play", str(folder), "--headless", "--trials", "1", "--seconds", "0.1"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "observation 'command.goal' is a custom quantity (Way to the goal in the torso's heading frame" in said
    assert "which `humoslope play` cannot compute" in said


def test_a_cell_that_does_not_fit_its_box_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell = ["--env.observations.voxels.terms.columns.params.cell", "0.3"]
    assert main(["train", TASK, "--run-dir", str(tmp_path / "run"), *TINY, *cell]) == 2
    assert "a voxel grid's cell of 0.3 m must divide its box of 1.6 m" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "run").exists()
