"""A mistake on the command line is one sentence, exit code 2, and nothing written."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import torch

import humoslope
from humoslope.cli import VERBS, main
from humoslope.learning import checkpoint
from humoslope.seal import sealed
from tests import processes
from tests.learning.states import checkpoint_state

TASK = "HumoSlope-Stage1-Unitree-G1"
OTHER_TASK = "HumoSlope-Stage1-NoZMP-Unitree-G1"
SMALL = [
    *("--preset", "cpu", "--env.num-envs", "4"),
    *("--env.scene.terrain.levels", "1", "--env.scene.terrain.num-columns", "9"),
]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Every command runs in an empty folder of its own, in which it must leave nothing but what the test put there."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def content(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() if path.is_file() else b"" for path in sorted(folder.rglob("*"))}


def test_without_a_verb_or_with_help_all_verbs_are_listed(capsys):
    for arguments in ([], ["--help"], ["-h"]):
        assert main(arguments) == 0
        said = capsys.readouterr().out
        assert all(f"{verb} " in said for verb in VERBS)


def test_a_user_sees_one_sentence_and_exit_code_2(folder):
    done = processes.run("tran", TASK)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "humoslope: verb 'tran' does not exist; did you mean 'train'?\n"
    assert content(folder) == {}


def test_a_gpu_without_memory_left_is_one_sentence(monkeypatch, capsys):
    def run(arguments):
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20.00 GiB.")

    monkeypatch.setattr("humoslope.cli.list.run", run)
    assert main(["list"]) == 2
    assert "the memory of the GPU is full; choose fewer envs" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("verb", "options", "written"),
    [
        ("ramps", ["--starts", "1", "--seconds", "0.1", "--grades", "0"], "ramps.json"),
        (
            "evaluate",
            ["--trials", "1", "--grades", "0", "--parallel-trials", "1", "--timeout-s", "0.1"],
            "heldout.json",
        ),
        ("record", ["--terrain", "ramp-up", "--grade", "5", "--seconds", "0.1"], "ramp-up-5.rollout.npz"),
    ],
)
def test_a_policy_walks_in_a_process_of_its_own(folder, untrained, verb, options, written):
    """Nothing else has loaded robots, terrains and tasks there."""
    shutil.copy(untrained, "model_0.pt")
    done = processes.run(verb, "model_0.pt", *options)
    assert (done.returncode, done.stderr) == (0, "")
    assert (folder / f"model_0.{written}").is_file()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["train"], "train needs a task: FastTD3-IsaacLab-Unitree-G1, "),
        (["train", "--env.num-envs", "3"], "train needs a task"),
        (["train", "HumoSlope-Stage1-Unitree-G2"], f"did you mean '{TASK}'?"),
        (["terrain", "ramp-upp"], "did you mean 'ramp-up'?"),
        (["bench", "HumoSlope-Stage1-Unitree-G2"], f"did you mean '{TASK}'?"),
        (["bench", TASK, "--sizes", "0"], "bench: sizes is (0); of each, it must be between 1 and 1,000,000 (too low)"),
        (["bench", TASK, "--out", "."], "'.' is a folder; name a file in it"),
        (["bench", TASK, "--checkpoint", "none.pt"], "'none.pt' does not exist"),
    ],
)
def test_a_misspelt_name_is_answered_with_the_nearest(mistake, folder, arguments, said):
    assert said in mistake(*arguments)
    assert content(folder) == {}


@pytest.mark.parametrize(
    ("arguments", "near"),
    [
        (["train", TASK, "--env.rewards.aliv.weight", "2"], "--env.rewards.alive.weight FLOAT"),
        (["train", TASK, "--env.rewards.alive.wieght=2"], "--env.rewards.alive.weight FLOAT"),
        (["train", TASK, "--env.num_env", "2"], "--env.num-envs INT"),
        (["train", TASK, "--env.scene.terrain.columns.ramp-upp", "1"], "--env.scene.terrain.columns.ramp-up FLOAT"),
        (["train", TASK, "--agent.hiden-dims", "8"], "--agent.hidden-dims"),
        (["train", TASK, "--resum", "latest"], "--resume STR"),
        (["train", TASK, "fast"], "Unrecognized options: fast"),
        (["bench", TASK, "--round", "1"], "--rounds INT"),
        (["evaluate", "model_0.pt", "--swep"], "--sweep"),
        (["ramps", "model_0.pt", "--start", "1"], "--starts INT"),
        (["terrain", "ramp-up", "--sede", "1"], "--seed INT"),
    ],
)
def test_a_mistyped_option_is_answered_with_the_nearest(capsys, folder, arguments, near):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    said = capsys.readouterr().err
    assert stop.value.code == 2
    assert "Unrecognized options" in said
    assert near in said
    assert content(folder) == {}


@pytest.mark.parametrize(
    "options",
    [
        ["--env.num-envs", "many"],
        ["--env.num-envs"],
        ["--preset", "tpu"],
        ["--env.sim.cone", "round"],
        ["--env.command.speed", "0.5"],
    ],
)
def test_a_value_of_the_wrong_kind_is_a_short_message_and_exit_code_2(capsys, folder, options):
    with pytest.raises(SystemExit) as stop:
        main(["train", TASK, *options])
    said = capsys.readouterr().err
    assert stop.value.code == 2
    assert options[0] in said
    assert said.count("\n") < 15
    assert content(folder) == {}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--env.num-envs", "0"], "env.num_envs is 0; it must be between 1 and 1,000,000"),
        (["--env.num-envs", "-3"], "env.num_envs is -3; it must be"),
        (["--env.seed", "-1"], "seed -1 must be at least 0"),
        (["--env.sim.timestep", "nan"], "env.sim.timestep is nan; it must be between 0.0001 and 0.05"),
        (["--env.num-envs", "1000000"], "GiB are free, enough for"),
        (
            ["--env.scene.terrain.cell", "0.002"],
            "million heights, of which there is room for 20 million",
        ),
        (["--env.sim.decimation", "0"], "env.sim.decimation is 0; it must be between 1 and 1,000"),
        (["--env.sim.device", "cuda"], "torch finds no CUDA here"),
        (["--env.sim.device", "tpu"], "is not one torch knows"),
        (["--env.scene.terrain.levels", "0"], "env.scene.terrain.levels is 0; it must be between 1 and 1,000"),
        (["--env.scene.terrain.columns.ramp-up", "-1"], "of 'ramp-up', it must be 0 or more"),
        (["--env.command.speed", "0.8", "0.3"], "env.command.speed is (0.8, 0.3); it must be (lowest, highest)"),
        (["--env.command.standing-share", "1.5"], "env.command.standing_share is 1.5; it must be between 0 and 1"),
        (["--env.events.friction.params.friction", "1.0", "0.5"], "friction is (1, 0.5); it must be (lowest, highest)"),
        (["--agent.max-iterations", "0"], "agent.max_iterations is 0; it must be between 1 and 1,000,000,000"),
        (["--agent.num-mini-batches", "1000"], "num_mini_batches 1000 is more than the 96 samples"),
        (["--run-dir", "file/run"], "is no folder one can write to"),
        (["--init", "none.pt"], "'none.pt' does not exist"),
        (["--resume", "none"], "run folder 'none' does not exist"),
        (["--resume", "latest"], f"there is no run of {TASK} with a checkpoint"),
        (["--resume", "empty"], "run folder 'empty' holds no checkpoint"),
    ],
)
def test_the_impossible_is_refused_before_anything_is_written(mistake, folder, options, said):
    if "cuda" in options and torch.cuda.is_available():
        pytest.skip("this machine has CUDA")
    (folder / "file").touch()
    (folder / "empty").mkdir()
    before = content(folder)
    assert said in mistake("train", TASK, *SMALL, *options)
    assert content(folder) == before


STATE = checkpoint_state(task=TASK, format=checkpoint.FORMAT)


@pytest.mark.parametrize(
    ("state", "said"),
    [
        (b"no checkpoint", "damaged or truncated"),
        (b"", "damaged or truncated"),
        ({"weights": 1}, "is not a HumoSlope checkpoint"),
        (STATE | {"format": 0}, "has format 0; this version reads format"),
        (STATE | {"task": OTHER_TASK}, f"belongs to task '{OTHER_TASK}', not to '{TASK}'"),
        (STATE, "damaged or truncated"),
    ],
)
def test_a_run_does_not_resume_from_what_is_not_its_checkpoint(mistake, folder, state, said):
    (folder / "run").mkdir()
    path = folder / "run" / "model_7.pt"
    if isinstance(state, bytes):
        path.write_bytes(state)
    else:
        torch.save(state, path)
        if state is not STATE:  # which lacks its checksum
            path.write_bytes(sealed(path.read_bytes()))
    before = content(folder)
    answer = mistake("train", TASK, *SMALL, "--resume", "run")
    assert said in answer
    assert "model_7.pt" in answer
    assert content(folder) == before


@pytest.mark.parametrize(
    ("file", "said"),
    [
        ("model_3.pt", "holds a run already; resume it with --resume run"),
        ("config.json", "holds a run that left no checkpoint"),
        ("starts", "holds a run that left no checkpoint"),
        ("console.log", "holds a run that left no checkpoint"),
    ],
)
def test_a_new_run_does_not_write_over_an_old_one(mistake, folder, file, said):
    (folder / "run").mkdir()
    (folder / "run" / file).write_text("mine")
    before = content(folder)
    assert said in mistake("train", TASK, *SMALL, "--run-dir", "run")
    assert content(folder) == before


def test_a_checkpoint_that_does_not_fit_leaves_the_run_as_it_was(mistake, folder, untrained):
    (folder / "run").mkdir()
    (folder / "run" / "model_0.pt").write_bytes(untrained.read_bytes())
    before = content(folder)
    narrow = ["--agent.hidden-dims", "8"]
    assert "add --agent.hidden-dims 24 16" in mistake("train", TASK, *narrow, "--resume", "run")
    assert content(folder) == before


def test_the_version_is_told(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"humoslope {humoslope.__version__}\n"


@pytest.mark.parametrize("verb", ["train", "bench", "check"])
def test_help_of_a_verb_that_takes_a_task_lists_every_task(capsys, verb):
    assert main([verb, "--help"]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"humoslope {verb} TASK [...]; ")
    assert TASK in said
    assert OTHER_TASK in said


def test_help_of_a_task_lists_every_field(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["train", TASK, "--help"])
    assert stop.value.code == 0
    said = capsys.readouterr().out
    assert "Path of a run folder" in said
    assert "Speed error at which the reward has fallen to 1/e" in said.replace("│", " ").replace("\n", " ")
    for option in ("--resume", "--env.rewards.alive.weight", "--agent.learning-rate", "--env.scene.terrain.levels"):
        assert option in said
