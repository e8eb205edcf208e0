"""FastTD3 is trained, resumed, measured, recorded and exported by the same verbs as PPO."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from humoslope.cli import main
from humoslope.cli.options import parse
from humoslope.cli.train import TrainArgs
from humoslope.deploy.contract import FILE
from humoslope.evaluation.report.curve import read_curves
from humoslope.learning import checkpoint

TASK = "FastTD3-IsaacLab-Unitree-G1"
TINY = [
    *("--preset", "cpu", "--env.num-envs", "8", "--env.sim.device", "cpu"),
    *("--env.scene.terrain.levels", "3", "--env.scene.terrain.num-columns", "9"),
    *("--agent.num-steps-per-env", "4", "--agent.save-interval", "1", "--agent.learning-starts", "4"),
    *("--agent.hidden-dims", "16", "8", "--agent.critic-hidden-dims", "16", "--agent.num-atoms", "11"),
    *("--agent.batch-size", "16", "--agent.buffer-steps", "32", "--agent.no-mixed-precision"),
]

pytestmark = pytest.mark.usefixtures("shared_operators")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two iterations."""
    folder = tmp_path_factory.mktemp("fasttd3") / "run"
    assert main(["train", TASK, "--run-dir", str(folder), *TINY, "--agent.max-iterations", "2"]) == 0
    return folder


def test_it_learns_and_logs(run: Path) -> None:
    curves = read_curves(run)
    assert list(curves["Replay/steps"].items()) == [(0, 4.0), (1, 8.0)]
    for name in ("Loss/critic", "Value/mean", "Value/actor", "Value/end_atoms", "Policy/saturated"):
        assert len(curves[name]) == 2, name
    first, second = (checkpoint.load(run / f"model_{i}.pt") for i in range(2))
    assert second["learner"]["updates"] == 16  # two for each of eight steps
    assert (first["policy"]["weights"]["mlp.0.weight"] != second["policy"]["weights"]["mlp.0.weight"]).any()


def test_a_resumed_run_says_that_its_buffer_is_empty_and_fills_it_before_it_learns_on(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shutil.copytree(run, tmp_path / "run")
    options = ["--agent.max-iterations", "4", "--agent.learning-starts", "8"]
    assert main(["train", TASK, "--resume", str(folder), *options]) == 0
    assert (
        "A checkpoint does not hold the replay buffer: the actor first collects 8 new steps" in capsys.readouterr().out
    )
    updates = [checkpoint.load(folder / f"model_{i}.pt")["learner"]["updates"] for i in range(4)]
    assert updates == [8, 16, 16, 24]
    assert list(read_curves(folder)["Replay/steps"]) == [0, 1, 2, 3]


@pytest.mark.parametrize("option", ["--agent.v-max", "--agent.action-bound", "--agent.learning-rate"])
def test_what_a_resumed_run_keeps_is_refused(run: Path, option: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", TASK, "--resume", str(run), option, "12"]) == 2
    assert f"{option} has no effect on a resumed run" in capsys.readouterr().err


def test_a_new_run_starts_from_its_actor_with_critics_of_its_own(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    start = ["train", TASK, "--run-dir", str(tmp_path / "run"), *TINY, "--init", str(run / "model_1.pt")]
    assert main([*start, "--agent.max-iterations", "1", "--agent.learning-starts", "5"]) == 0
    before, after = (checkpoint.load(path) for path in (run / "model_1.pt", tmp_path / "run" / "model_0.pt"))
    weights = "mlp.0.weight"
    assert (before["policy"]["weights"][weights] == after["policy"]["weights"][weights]).all()
    assert after["learner"]["updates"] == 0
    assert main([*start, "--run-dir", str(tmp_path / "other"), "--agent.action-bound", "2"]) == 2
    assert "has actions of at most 3, this run's of 2; add --agent.action-bound 3." in capsys.readouterr().err


def test_it_is_measured_recorded_exported_and_played(run: Path) -> None:
    assert main(["ramps", str(run), "--starts", "1", "--seconds", "0.1", "--grades", "0"]) == 0
    assert json.loads((run / "model_1.ramps.json").read_text())["checkpoint"]["iteration"] == 1
    assert main(["evaluate", str(run), "--trials", "1", "--grades", "0", "--timeout-s", "0.1"]) == 0
    assert main(["record", str(run), "--terrain", "ramp-up", "--grade", "5", "--seconds", "0.1"]) == 0
    assert main(["export", str(run)]) == 0
    contract = json.loads((run / "model_1.export" / FILE).read_text())
    assert contract["training"]["task"] == TASK
    assert main(["play", str(run / "model_1.export"), "--headless", "--trials", "1", "--seconds", "0.1"]) == 0


def test_a_buffer_beyond_memory_is_said_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [*TINY, "--agent.buffer-steps", "1000000000"]
    assert main(["train", TASK, "--run-dir", str(tmp_path / "run"), *options]) == 2
    said = capsys.readouterr().err
    assert "agent.buffer_steps 1000000000 takes" in said
    assert "steps fit." in said
    assert not (tmp_path / "run").exists()


def test_options_reach_it() -> None:
    agent = parse(TrainArgs(), TASK, ["--preset", "cpu", "--agent.exploration-std", "0.1", "0.2", "--agent.symmetry"])[
        0
    ].agent
    assert (agent.exploration_std, agent.symmetry, agent.batch_size) == ((0.1, 0.2), True, 2048)
