"""A run can be repeated, stopped, killed and resumed, and its folder tells what it was."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch
from humoslope.learning.runner import Runner, seed_everything
from rich.console import Console

from humoslope.cli import main
from humoslope.cli.options import parse
from humoslope.cli.train import TrainArgs
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.evaluation.report.curve import read_curves
from humoslope.learning import checkpoint
from humoslope.learning.logger import TrainingLogger

PATIENCE_S = 600.0
"""How long a child process may take before the test gives up on it; no result depends on it."""


def leaves(value: Any, path: str = "") -> dict[str, Any]:
    if isinstance(value, dict):
        return {k: v for name, child in value.items() for k, v in leaves(child, f"{path}/{name}").items()}
    if isinstance(value, list | tuple):
        return {k: v for i, child in enumerate(value) for k, v in leaves(child, f"{path}/{i}").items()}
    return {path: value}


def same(a: Any, b: Any) -> bool:
    return torch.equal(a, b) if isinstance(a, torch.Tensor) else bool(a == b)


def assert_same(first: Path, second: Path, but: tuple[str, ...] = ("/total_time",)) -> None:
    a, b = leaves(checkpoint.load(first)), leaves(checkpoint.load(second))
    assert a.keys() == b.keys()
    assert [path for path in a if path not in but and not same(a[path], b[path])] == []


def start(*arguments: str) -> subprocess.Popen[str]:
    code = "import sys; from humoslope.cli import main; sys.exit(main())"
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def test_one_seed_gives_one_result(train, finished, tmp_path):
    again = train(tmp_path / "again", "--agent.max-iterations", "3")
    for number in range(3):
        assert_same(finished / f"model_{number}.pt", again / f"model_{number}.pt")


def test_another_seed_gives_another_result(train, finished, tmp_path):
    other = train(tmp_path / "other", "--agent.max-iterations", "1", "--env.seed", "2")
    first, second = (checkpoint.load(run / "model_0.pt")["actor_state_dict"] for run in (finished, other))
    assert any(not torch.equal(first[name], second[name]) for name in first)


def test_the_folder_of_a_run_tells_what_it_was(finished, task):
    config = json.loads((finished / "config.json").read_text())
    assert config["task"] == task
    assert config["env"]["num_envs"] == 8
    assert config["agent"]["hidden_dims"] == [16, 16]
    assert (finished / "git.txt").read_text().startswith("commit ")
    assert "--env.num-envs 8" in (finished / "options.txt").read_text()
    assert "3/3" in (finished / "console.log").read_text()
    files = {path.name for path in finished.iterdir() if not path.name.startswith("events.out.tfevents.")}
    models = {f"model_{number}.pt" for number in range(3)}
    assert files == models | {"config.json", "git.txt", "options.txt", "console.log"}


def test_the_curves_of_a_run_count_its_iterations_and_steps(finished):
    curves = read_curves(finished)
    assert list(curves["Perf/total_steps"].items()) == [(0, 32.0), (1, 64.0), (2, 96.0)]
    assert list(curves["Train/reward"]) == [0, 1, 2]


def test_the_console_holds_a_table_of_each_manager_and_no_chatter(finished):
    console = (finished / "console.log").read_text()
    for title in ("Actions", "Commands", "Observations", "Rewards", "Terminations", "Events", "Curricula"):
        assert title in console
    for chatter in ("Resolved observation sets", "Actor Model", "git repository"):
        assert chatter not in console


def test_a_resumed_run_keeps_the_options_it_was_started_with(finished, task, tmp_path, capsys):
    run = shutil.copytree(finished, tmp_path / "run")
    assert main(["train", task, "--resume", str(run), "--agent.max-iterations", "5"]) == 0
    assert f"Resumed from {run / 'model_2.pt'}" in capsys.readouterr().out.replace("\n", "")
    config = json.loads((run / "config.json").read_text())
    assert config["env"]["num_envs"] == 8
    assert config["agent"]["hidden_dims"] == [16, 16]
    assert config["agent"]["max_iterations"] == 5
    options = (run / "options.txt").read_text().split()
    assert options.count("--agent.max-iterations") == 1
    assert "--resume" not in options
    curves = read_curves(run)
    assert list(curves["Perf/total_steps"].items()) == [(i, 32.0 * (i + 1)) for i in range(5)]
    assert checkpoint.load(run / "model_4.pt")["iter"] == 4


def test_a_complete_run_has_nothing_left_to_do(finished, task, tmp_path, capsys):
    run = shutil.copytree(finished, tmp_path / "run")
    assert main(["train", task, "--resume", str(run)]) == 0
    assert "Nothing left to do: 3 iterations are done." in capsys.readouterr().out


def test_a_killed_run_resumes_from_its_last_checkpoint(task, tiny, tmp_path):
    run = tmp_path / "run"
    child = start("train", task, "--run-dir", str(run), *tiny, "--agent.max-iterations", "1000000")
    try:
        deadline = time.monotonic() + PATIENCE_S
        while not (run / "model_1.pt").exists():
            assert child.poll() is None, child.communicate()[0]
            assert time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        child.send_signal(signal.SIGKILL)
        child.communicate()
    last = checkpoint.latest(run)
    done = checkpoint.load(last, task)["iter"] + 1
    assert last.name == f"model_{done - 1}.pt"

    assert main(["train", task, "--resume", str(run), "--agent.max-iterations", str(done + 2)]) == 0
    assert checkpoint.load(run / f"model_{done + 1}.pt")["total_steps"] == 32 * (done + 2)
    assert list(read_curves(run)["Perf/total_steps"].items()) == [(i, 32.0 * (i + 1)) for i in range(done + 2)]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_run_after_its_iteration_with_a_checkpoint(train, task, tmp_path, monkeypatch, capsys, number):
    shown = TrainingLogger._print

    def interrupt(self: TrainingLogger, it: int, *rest: Any) -> None:
        shown(self, it, *rest)
        if it == 1:
            os.kill(os.getpid(), number)

    monkeypatch.setattr(TrainingLogger, "_print", interrupt)
    before = signal.getsignal(number)
    run = train(tmp_path / "run", "--agent.max-iterations", "1000000", "--agent.save-interval", "1000000")
    assert signal.getsignal(number) == before
    said = capsys.readouterr().out.replace("\n", "")
    assert "Stopping after this iteration" in said
    assert f"Stopped after iteration 2; saved {run / 'model_1.pt'}." in said
    assert checkpoint.load(run / "model_1.pt", task)["total_steps"] == 64
    assert list(read_curves(run)["Perf/total_steps"]) == [0, 1]


def make_runner(task: str, tiny: list[str], *options: str) -> Runner:
    cfg, _ = parse(TrainArgs(), task, [*tiny, *options])
    seed_everything(cfg.env.seed)
    return Runner(task, ManagerBasedRlEnv(cfg.env), cfg.agent, None, Console(quiet=True))


def test_resuming_restores_levels_harness_counters_and_random_numbers(task, tiny, tmp_path):
    first = make_runner(task, tiny)
    env = first.env.env
    env.events["harness"].scale = torch.tensor(0.37)
    env.tiles.set_level(torch.arange(8) % 3)
    first.current_learning_iteration, first.logger.tot_timesteps, first.logger.tot_time = 41, 12345, 67.0
    first.alg.optimizer.param_groups[0]["lr"] = 3e-4
    first.save(str(tmp_path / "model_41.pt"))
    expected = torch.rand(3)

    second = make_runner(task, tiny, "--env.seed", "5")
    second.resume(tmp_path / "model_41.pt")
    assert torch.equal(torch.rand(3), expected)
    env = second.env.env
    assert env.events["harness"].scale.item() == pytest.approx(0.37)
    assert env.tiles.level.tolist() == [i % 3 for i in range(8)]
    assert second.current_learning_iteration == 42
    assert (second.logger.tot_timesteps, second.logger.tot_time) == (12345, 67.0)
    assert second.alg.learning_rate == 3e-4
    for name, value in first.alg.actor.state_dict().items():
        assert torch.equal(value, second.alg.actor.state_dict()[name])


def test_a_warm_start_takes_the_actor_and_nothing_else(task, tiny, finished):
    runner = make_runner(task, tiny, "--env.seed", "5")
    critic = {name: value.clone() for name, value in runner.alg.critic.state_dict().items()}
    runner.warm_start(finished / "model_2.pt")
    trained = checkpoint.load(finished / "model_2.pt")
    actor = runner.alg.actor.state_dict()
    assert all(torch.equal(actor[name], value) for name, value in trained["actor_state_dict"].items())
    assert all(torch.equal(value, critic[name]) for name, value in runner.alg.critic.state_dict().items())
    assert runner.current_learning_iteration == 0


def test_a_checkpoint_of_another_width_is_refused_by_name(task, tiny, finished):
    runner = make_runner(task, tiny, "--agent.hidden-dims", "8", "8")
    with pytest.raises(UserError, match=r"model_2.pt' does not fit the configured networks"):
        runner.resume(finished / "model_2.pt")


def test_more_mini_batches_than_samples_are_refused(task, tiny):
    with pytest.raises(UserError, match="num_mini_batches 64 is more than the 32 samples of a rollout"):
        make_runner(task, tiny, "--agent.num-mini-batches", "64")
