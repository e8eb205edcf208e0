"""The whole chain as a user types it: Stage I, calibration, Stage II."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import torch

from humoslope.cli import main
from humoslope.evaluation.swing.file import load_calibration
from humoslope.learning import checkpoint
from humoslope.learning.policy import read_provenance

WALKER = Path(__file__).parents[2] / "experiments/checkpoints/stage1.pt"
STAGE_1, STAGE_2 = "HumoSlope-Stage1-Unitree-G1", "HumoSlope-Stage2-Unitree-G1"
TINY = [
    *("--preset", "cpu", "--env.num-envs", "8", "--env.sim.device", "cpu", "--env.scene.terrain.levels", "3"),
    *("--env.scene.terrain.num-columns", "9", "--agent.num-steps-per-env", "4", "--agent.num-mini-batches", "2"),
    *("--agent.num-learning-epochs", "1", "--agent.no-mixed-precision", "--agent.save-interval", "1"),
]
WALK = ["--grades", "-10", "0", "10", "15", "20", "--starts", "1", "--seconds", "6.5", "--least-samples", "10"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder in which the chain has been run; Stage I goes on from a policy that walks, so that there is a swing."""
    folder = tmp_path_factory.mktemp("chain")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        first = ["--init", str(WALKER), "--run-dir", f"logs/{STAGE_1}/1", "--agent.max-iterations", "2"]
        # Slowly: two updates on 32 samples each at the usual rate may throw down a policy that walks.
        assert main(["train", STAGE_1, *TINY, *first, "--agent.learning-rate", "1e-5"]) == 0
        assert main(["calibrate", f"logs/{STAGE_1}/1", *WALK]) == 0
        assert main(["train", STAGE_2, *TINY, "--run-dir", "stage2", "--agent.max-iterations", "2"]) == 0
    return folder


def test_stage_2_starts_from_the_newest_stage_1_with_its_calibration_and_says_so(folder):
    said = (folder / "stage2" / "console.log").read_text()
    assert f"Starts from the actor of logs/{STAGE_1}/1/model_1.pt" in said
    calibration, _ = load_calibration(folder / "logs" / STAGE_1 / "1" / "model_1.swing.json")
    assert f"beta0 {calibration.beta0:.4g}" in said
    options = (folder / "stage2" / "starts" / "1" / "options.txt").read_text()
    assert f"--env.rewards.swing-hip.params.beta0 {calibration.beta0!r}" in options  # a resumed run has it too


def test_its_actor_is_stage_1s_and_its_critic_is_new_and_larger(folder):
    first = checkpoint.load(folder / "logs" / STAGE_1 / "1" / "model_1.pt", STAGE_1)
    second = checkpoint.load(folder / "stage2" / "model_0.pt", STAGE_2)
    for name, weight in first["policy"]["weights"].items():
        if "normalizer" not in name:
            assert torch.equal(weight, second["policy"]["weights"][name]), name
    width = "mlp.0.weight"
    assert (
        second["learner"]["critic_state_dict"][width].shape[1]
        == first["learner"]["critic_state_dict"][width].shape[1] + 5
    )


def test_its_checkpoints_tell_the_whole_descent(folder):
    provenance = read_provenance(folder / "stage2" / "model_1.pt")
    assert provenance.harness is None
    assert provenance.parent is not None
    assert provenance.parent.task == STAGE_1
    assert provenance.parent.parent is not None
    assert provenance.parent.parent.total_steps == read_provenance(WALKER).total_steps


def test_a_calibration_of_another_checkpoint_is_refused(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    foreign = ["--init", f"logs/{STAGE_1}/1/model_0.pt", "--calibration", f"logs/{STAGE_1}/1/model_1.swing.json"]
    assert main(["train", STAGE_2, *TINY, "--run-dir", str(tmp_path / "run"), *foreign]) == 2
    assert "the calibration was made from checkpoint" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_checkpoint_without_calibration_is_refused_with_what_to_do(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    bare = ["--init", f"logs/{STAGE_1}/1/model_0.pt", "--run-dir", str(tmp_path / "run")]
    assert main(["train", STAGE_2, *TINY, *bare]) == 2
    said = capsys.readouterr().err
    assert "make calibrate CHECKPOINT=" in said
    assert "--calibration prior" in said
    assert main(["train", STAGE_2, *TINY, *bare, "--calibration", "prior", "--agent.max-iterations", "1"]) == 0


def test_a_checkpoint_of_another_task_is_refused(folder, tmp_path, capsys):
    foreign = ["--init", str(folder / "stage2" / "model_1.pt"), "--run-dir", str(tmp_path / "run")]
    assert main(["train", STAGE_2, *TINY, *foreign]) == 2
    assert f"belongs to task '{STAGE_2}', not to '{STAGE_1}'" in capsys.readouterr().err


def test_an_ablation_whose_own_stage_1_is_missing_says_which(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["train", "HumoSlope-Stage2-NoZMP-Unitree-G1", *TINY]) == 2
    assert "starts from a checkpoint of HumoSlope-Stage1-NoZMP-Unitree-G1, and there is none" in capsys.readouterr().err


def test_a_calibration_where_there_is_nothing_to_set_is_refused(tmp_path, capsys):
    assert main(["train", STAGE_1, *TINY, "--run-dir", str(tmp_path / "run"), "--calibration", "prior"]) == 2
    assert "no reward that a swing calibration sets" in capsys.readouterr().err


def test_without_a_run_of_ones_own_the_shipped_checkpoint_is_taken(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    options = ["--run-dir", "run", "--calibration", "prior", "--agent.max-iterations", "1"]
    assert main(["train", STAGE_2, *TINY, *options]) == 0
    parent = read_provenance(tmp_path / "run" / "model_0.pt").parent
    assert parent is not None
    assert parent.sha256 == checkpoint.digest(WALKER)
    shutil.rmtree(tmp_path / "run")
