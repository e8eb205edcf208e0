"""A run can be repeated, stopped, killed and resumed, and its folder tells what it was."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch
from rich.console import Console

from humoslope.cli import main
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.evaluation.report.curve import read_curves
from humoslope.learning import checkpoint
from humoslope.learning.logger import ProgressLine
from humoslope.learning.ppo import PpoLearner
from humoslope.learning.rng import seed_everything
from humoslope.learning.run_folder import saved_options
from humoslope.learning.trainer import Trainer, tf32_products
from humoslope.managers import RewardTermCfg
from humoslope.words import option_groups
from tests import processes

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
    a, b = (leaves(checkpoint.load(path)) for path in (first, second))
    assert a.keys() == b.keys()
    assert [path for path in a if path not in but and not same(a[path], b[path])] == []


def assert_same_values(first: Any, second: Any) -> None:
    a, b = leaves(first), leaves(second)
    assert a.keys() == b.keys()
    assert [path for path in a if not same(a[path], b[path])] == []


def test_one_seed_gives_one_result(train, finished, tmp_path):
    again = train(tmp_path / "again", "--agent.max-iterations", "3")
    for number in range(3):
        assert_same(finished / f"model_{number}.pt", again / f"model_{number}.pt")


def test_another_seed_gives_another_result(train, finished, tmp_path):
    other = train(tmp_path / "other", "--agent.max-iterations", "1", "--env.seed", "2")
    first, second = (checkpoint.load(run / "model_0.pt")["policy"]["weights"] for run in (finished, other))
    assert any(not torch.equal(first[name], second[name]) for name in first)


def test_the_folder_of_a_run_tells_what_it_was(finished, task):
    record = finished / "starts" / "1"
    config = json.loads((record / "config.json").read_text())
    assert config["task"] == task
    assert config["env"]["num_envs"] == 8
    assert config["agent"]["hidden_dims"] == [16, 16]
    assert (record / "git.txt").read_text().startswith("commit ")
    assert "--env.num-envs 8" in (record / "options.txt").read_text()
    about = json.loads((record / "start.json").read_text())
    assert (about["iteration"], about["total_steps"], about["from"]) == (0, 0, None)
    assert "3/3" in (finished / "console.log").read_text()
    files = {path.name for path in finished.iterdir() if not path.name.startswith("events.out.tfevents.")}
    models = {f"model_{number}.pt" for number in range(3)}
    assert files == models | {"starts", "console.log", "episodes_2.pt"}


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
    config = json.loads((run / "starts" / "2" / "config.json").read_text())
    assert config["env"]["num_envs"] == 8
    assert config["agent"]["hidden_dims"] == [16, 16]
    assert config["agent"]["max_iterations"] == 5
    about = json.loads((run / "starts" / "2" / "start.json").read_text())
    assert (about["iteration"], about["total_steps"]) == (3, 96)
    assert (run / "starts" / "2" / "options.txt").read_text() == "--agent.max-iterations 5"
    assert json.loads((run / "starts" / "1" / "config.json").read_text())["agent"]["max_iterations"] == 3
    assert option_groups(saved_options(run, total_steps=96))["--agent.max-iterations"][1:] == ["3"]
    assert option_groups(saved_options(run))["--agent.max-iterations"][1:] == ["5"]
    curves = read_curves(run)
    assert list(curves["Perf/total_steps"].items()) == [(i, 32.0 * (i + 1)) for i in range(5)]
    assert checkpoint.load(run / "model_4.pt")["iteration"] == 4


def test_a_complete_run_has_nothing_left_to_do(finished, task, tmp_path, capsys):
    run = shutil.copytree(finished, tmp_path / "run")
    assert main(["train", task, "--resume", str(run)]) == 0
    assert "Nothing left to do: 3 iterations are done." in capsys.readouterr().out


def test_a_killed_run_resumes_from_its_last_checkpoint(task, tiny, tmp_path):
    run = tmp_path / "run"
    child = processes.start("train", task, "--run-dir", str(run), *tiny, "--agent.max-iterations", "1000000")
    try:
        deadline = time.monotonic() + PATIENCE_S
        while not (run / "model_1.pt").exists():
            assert child.poll() is None, child.wait()
            assert time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        os.kill(child.pid, signal.SIGKILL)
        child.wait()
    last = checkpoint.latest(run)
    done = checkpoint.load(last, task)["iteration"] + 1
    assert last.name == f"model_{done - 1}.pt"

    assert main(["train", task, "--resume", str(run), "--agent.max-iterations", str(done + 2)]) == 0
    assert checkpoint.load(run / f"model_{done + 1}.pt")["total_steps"] == 32 * (done + 2)
    assert list(read_curves(run)["Perf/total_steps"].items()) == [(i, 32.0 * (i + 1)) for i in range(done + 2)]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_run_after_its_iteration_with_a_checkpoint(train, task, tmp_path, monkeypatch, capsys, number):
    shown = ProgressLine.show

    def interrupt(self: ProgressLine, iteration: int, values: dict[str, float]) -> None:
        shown(self, iteration, values)
        if iteration == 1:
            os.kill(os.getpid(), number)

    monkeypatch.setattr(ProgressLine, "show", interrupt)
    before = signal.getsignal(number)
    many = ["--agent.max-iterations", "1000000", "--agent.save-interval", "1000000"]
    run = train(tmp_path / "run", *many, code=128 + number)
    assert signal.getsignal(number) == before
    said = capsys.readouterr().out.replace("\n", "")
    assert "Stopping after this iteration" in said
    assert f"Stopped after iteration 2; saved {run / 'model_1.pt'}." in said
    assert checkpoint.load(run / "model_1.pt", task)["total_steps"] == 64
    assert list(read_curves(run)["Perf/total_steps"]) == [0, 1]


def test_a_resumed_run_equals_one_that_was_never_stopped(train, finished, task, tmp_path, capsys):
    whole = train(tmp_path / "whole", "--agent.max-iterations", "6")
    run = shutil.copytree(finished, tmp_path / "run")
    assert main(["train", task, "--resume", str(run), "--agent.max-iterations", "6"]) == 0
    assert "Its episodes go on where they were." in capsys.readouterr().out
    for number in range(3, 6):
        assert_same(
            whole / f"model_{number}.pt",
            run / f"model_{number}.pt",
            but=("/total_time", "/config/agent/max_iterations"),
        )
    first, second = (checkpoint.load_sealed(folder / "episodes_5.pt")["state"] for folder in (whole, run))
    assert_same_values(first, second)


@pytest.mark.parametrize(
    ("spoil", "options", "why"),
    [
        (lambda run: (run / "episodes_2.pt").unlink(), [], "there is no episodes_2.pt beside it"),
        (
            lambda run: shutil.copy(run / "model_1.pt", run / "model_2.pt"),
            [],
            "episodes_2.pt belongs to another checkpoint",
        ),
        (lambda run: (run / "episodes_2.pt").write_bytes(b"PK"), [], "episodes_2.pt is damaged or of another version"),
        (lambda run: None, ["--env.episode-length-s", "5"], "the environment is configured differently now"),
    ],
)
def test_a_run_that_cannot_go_on_exactly_says_why(finished, task, tmp_path, capsys, spoil, options, why):
    run = shutil.copytree(finished, tmp_path / "run")
    spoil(run)
    assert main(["train", task, "--resume", str(run), "--agent.max-iterations", "4", *options]) == 0
    said = capsys.readouterr().out.replace("\n", " ")
    assert f"Its episodes start anew ({why}), so that it departs from a run that was never stopped." in said


def test_a_closed_pipe_does_not_end_a_training(task, tiny, tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as nobody, pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stdout", nobody)
        assert main(["train", task, "--run-dir", str(tmp_path / "run"), *tiny, "--agent.max-iterations", "2"]) == 0
        nobody.close = lambda: None
    console = (tmp_path / "run" / "console.log").read_text()
    assert "The terminal is gone (Broken pipe); training goes on, and this file tells how." in console
    assert "2/2" in console
    assert checkpoint.load(tmp_path / "run" / "model_1.pt")["iteration"] == 1


def test_episodes_that_memory_has_no_room_for_are_not_kept_and_that_is_said(task, tiny, tmp_path, monkeypatch, capsys):
    run = tmp_path / "run"
    monkeypatch.setattr("humoslope.learning.trainer.free_memory", lambda device: 1000)
    assert main(["train", task, "--run-dir", str(run), *tiny, "--agent.max-iterations", "1"]) == 0
    assert "The episodes are not kept: that needs 0.0 GiB of memory" in capsys.readouterr().out
    assert [path.name for path in run.glob("*.pt")] == ["model_0.pt"]
    monkeypatch.undo()
    assert main(["train", task, "--resume", str(run), "--agent.max-iterations", "2"]) == 0
    assert "there is no episodes_0.pt beside it" in capsys.readouterr().out.replace("\n", " ")


def test_a_run_folder_that_is_removed_midway_is_made_anew_with_all_that_belongs_into_it(
    task, tiny, tmp_path, monkeypatch, capsys
):
    run, calls, own = tmp_path / "run", [], PpoLearner.update

    def update(learner, obs):
        calls.append(1)
        if len(calls) == 2:
            shutil.rmtree(run)
        return own(learner, obs)

    monkeypatch.setattr(PpoLearner, "update", update)
    assert main(["train", task, "--run-dir", str(run), *tiny, "--agent.max-iterations", "4"]) == 0
    assert "was removed; it is made anew, without what was in it" in capsys.readouterr().out.replace("\n", " ")
    assert checkpoint.load(run / "model_3.pt")["iteration"] == 3
    assert option_groups(saved_options(run))["--agent.max-iterations"][1:] == ["4"]
    assert list(read_curves(run)["Perf/total_steps"])[-1] == 3
    assert "4/4" in (run / "console.log").read_text()


@pytest.mark.parametrize(("where", "saved"), [("act", "model_1.pt"), ("update", "model_0.pt")])
def test_an_error_ends_a_run_with_its_state_saved_or_the_last_good_one_named(
    task, tiny, tmp_path, monkeypatch, capsys, where, saved
):
    calls, own = [], getattr(PpoLearner, where)

    def fail(self: PpoLearner, obs: Any) -> Any:
        calls.append(1)
        if len(calls) > 2 * (4 if where == "act" else 1):
            raise ZeroDivisionError
        return own(self, obs)

    monkeypatch.setattr(PpoLearner, where, fail)
    run, options = tmp_path / "run", ["--agent.max-iterations", "9", "--agent.save-interval", "1000"]
    with pytest.raises(ZeroDivisionError):
        main(["train", task, "--run-dir", str(run), *tiny, *options])
    said = capsys.readouterr().out.replace("\n", "")
    assert f"ZeroDivisionError after 2 iterations; the last good checkpoint is {run / saved}." in said
    assert checkpoint.latest(run).name == saved


def test_a_full_disk_is_a_sentence_that_names_the_last_good_checkpoint(task, tiny, tmp_path, monkeypatch, capsys):
    written = Path.write_bytes

    def write_bytes(self: Path, content: bytes) -> int:
        if self.name.startswith(".model_1.pt."):
            written(self, content[:100])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self))
        return written(self, content)

    monkeypatch.setattr(Path, "write_bytes", write_bytes)
    run = tmp_path / "run"
    assert main(["train", task, "--run-dir", str(run), *tiny, "--agent.max-iterations", "9"]) == 2
    said = capsys.readouterr().err
    place, good = run / "model_1.pt", run / "model_0.pt"
    assert said == (
        f"humoslope: cannot write '{place}': No space left on device; the last good checkpoint is {good}.\n"
    )
    assert [path.name for path in run.glob(".*")] == []
    checkpoint.load(good)


def test_what_a_killed_process_left_half_written_is_removed_at_the_next_start(finished, task, tmp_path):
    run = shutil.copytree(finished, tmp_path / "run")
    left, other = run / ".model_8.pt.n2iha01o.pt", run / ".notes.pt"
    left.write_bytes(b"half")
    other.write_bytes(b"mine")
    assert main(["train", task, "--resume", str(run)]) == 0
    assert not left.exists()
    assert other.exists()


def test_resuming_restores_levels_harness_counters_and_random_numbers(make_trainer, tmp_path):
    first = make_trainer()
    env = first.env
    env.events["harness"].scale = torch.tensor(0.37)
    env.tiles.set_level(torch.arange(8) % 3)
    first.iteration, first.total_steps, first.total_time = 42, 12345, 67.0
    first.learner.alg.optimizer.param_groups[0]["lr"] = 3e-4
    first.save(tmp_path / "model_41.pt")
    expected = torch.rand(3)

    second = make_trainer("--env.seed", "5")
    second.resume(tmp_path / "model_41.pt")
    assert torch.equal(torch.rand(3), expected)
    env = second.env
    assert env.events["harness"].scale.item() == pytest.approx(0.37)
    assert env.tiles.level.tolist() == [i % 3 for i in range(8)]
    assert (second.iteration, second.total_steps, second.total_time) == (42, 12345, 67.0)
    assert second.learner.alg.learning_rate == 3e-4
    for name, value in first.learner.policy.state_dict().items():
        assert torch.equal(value, second.learner.policy.state_dict()[name])


def test_episodes_of_a_new_start_are_spread_over_their_length(make_trainer):
    trainer = make_trainer("--env.num-envs", "64")
    trainer.start_episodes()
    steps = trainer.env.episode_length_buf
    assert steps.min() >= 0
    assert steps.max() < trainer.env.max_episode_length
    assert len(steps.unique()) > 48


def test_a_warm_start_takes_the_actor_and_nothing_else(on_shared_env, finished):
    trainer = on_shared_env(seed_offset=4)
    critic = {name: value.clone() for name, value in trainer.learner.alg.critic.state_dict().items()}
    trainer.warm_start(finished / "model_2.pt")
    trained = checkpoint.load(finished / "model_2.pt")
    actor = trainer.learner.policy.state_dict()
    assert all(torch.equal(actor[name], value) for name, value in trained["policy"]["weights"].items())
    assert all(torch.equal(value, critic[name]) for name, value in trainer.learner.alg.critic.state_dict().items())
    assert trainer.iteration == 0


def test_a_checkpoint_of_another_width_is_refused_with_the_option_that_helps(on_shared_env, finished):
    trainer = on_shared_env("--agent.hidden-dims", "8", "8")
    with pytest.raises(UserError, match=r"model_2.pt' has hidden layers of .* add --agent.hidden-dims 16 16"):
        trainer.resume(finished / "model_2.pt")


def test_a_checkpoint_of_another_activation_is_refused_with_the_option_that_helps(on_shared_env, finished):
    trainer = on_shared_env("--agent.activation", "tanh")
    with pytest.raises(UserError, match=r"has the activation elu, this run's tanh; add --agent.activation elu\."):
        trainer.warm_start(finished / "model_2.pt")


def test_actor_and_critic_have_the_layers_that_are_asked_for(on_shared_env):
    options = ("--agent.hidden-dims", "12", "10", "--agent.critic-hidden-dims", "6", "--agent.activation", "tanh")
    algorithm = on_shared_env(*options).learner.alg
    for network, widths in ((algorithm.actor, [12, 10]), (algorithm.critic, [6])):
        linear = [layer for layer in network.mlp if isinstance(layer, torch.nn.Linear)]
        assert [layer.out_features for layer in linear[:-1]] == widths
        assert sum(isinstance(layer, torch.nn.Tanh) for layer in network.mlp) == len(widths)


def test_more_mini_batches_than_samples_are_refused(on_shared_env):
    with pytest.raises(UserError, match="num_mini_batches 64 is more than the 32 samples of a rollout"):
        on_shared_env("--agent.num-mini-batches", "64")


def test_an_option_without_effect_on_a_resumed_run_is_refused(finished, task, tmp_path, capsys):
    run = shutil.copytree(finished, tmp_path / "run")
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    for option, value in {
        "--agent.learning-rate": "1e-4",
        "--agent.init-std": "0.5",
        "--env.seed": "7",
        "--preset": "gpu",
        "--init": str(finished),
        "--run-dir": "elsewhere",
    }.items():
        assert main(["train", task, "--resume", str(run), option, value]) == 2
        assert f"{option} has no effect on a resumed run" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


def test_a_resumed_run_goes_on_with_the_configuration_of_its_checkpoint_and_not_with_todays_task(
    finished, task, tmp_path, monkeypatch
):
    run = shutil.copytree(finished, tmp_path / "run")
    shutil.rmtree(run / "starts")
    assert main(["train", task, "--resume", str(run), "--agent.max-iterations", "4"]) == 0
    config = json.loads((run / "starts" / "1" / "config.json").read_text())
    assert (config["env"]["num_envs"], config["agent"]["hidden_dims"]) == (8, [16, 16])


@pytest.mark.parametrize("number", [1, 2])
def test_a_value_that_is_not_finite_ends_the_run_with_its_last_good_weights(
    train, task, tiny, tmp_path, monkeypatch, capsys, number
):
    asked: list[int] = []

    def non_finite(self: ManagerBasedRlEnv) -> list[str]:
        asked.append(1)
        return ["reward 'zmp' was not finite in 3 of 8 envs"] if len(asked) == number else []

    monkeypatch.setattr(ManagerBasedRlEnv, "non_finite", non_finite)
    run = tmp_path / "run"
    options = ["--agent.max-iterations", "9", "--agent.save-interval", "1000"]
    assert main(["train", task, "--run-dir", str(run), *tiny, *options]) == 2
    said = capsys.readouterr().err
    assert "reward 'zmp' was not finite in 3 of 8 envs" in said
    assert f"(iteration {number})" in said
    if number == 1:
        assert "there is no checkpoint yet" in said
        assert list(run.glob("model_*.pt")) == []
    else:
        assert f"the last good checkpoint is {run / 'model_0.pt'}" in said
        checkpoint.load(run / "model_0.pt")


def test_a_loss_that_is_not_finite_ends_the_run_and_its_weights_are_not_saved(on_shared_env):
    trainer = on_shared_env()
    update = trainer.learner.update
    trainer.learner.update = lambda obs: {**update(obs), "Loss/value": float("nan")}
    with pytest.raises(UserError, match=r"Loss/value is not finite \(iteration 1\); there is no checkpoint yet"):
        trainer.iterate()


def test_weights_that_are_not_finite_are_never_written(on_shared_env, tmp_path):
    trainer = on_shared_env()
    trainer.iterate()
    next(iter(trainer.learner.policy.parameters())).data[0] = float("inf")
    with pytest.raises(UserError, match=r"is not written: policy\.weights\..* holds values that are not finite"):
        trainer.save(tmp_path / "model_0.pt")
    assert list(tmp_path.iterdir()) == []


def load_share(env: ManagerBasedRlEnv) -> torch.Tensor:
    """A reward that is 0/0 while both feet are in the air, as they are when robots start."""
    force = env.signals.foot_force
    return force[:, 0] / force.sum(dim=1)


def test_a_reward_that_divides_by_zero_is_named_with_its_envs_and_iteration(task, tiny_cfg):
    cfg = tiny_cfg()
    cfg.env.rewards.load_share = RewardTermCfg(load_share)
    seed_everything(cfg.env.seed)
    trainer = Trainer(task, cfg, ManagerBasedRlEnv(cfg.env), None, Console(quiet=True))
    said = (
        r"reward 'load_share' was not finite in \d of 8 envs \(first in step \d+ since the last look\) \(iteration 1\)"
    )
    with pytest.raises(UserError, match=said):
        trainer.iterate()


def test_tf32_is_on_for_a_gpus_update_and_off_again_after_it():
    before = torch.backends.cuda.matmul.fp32_precision
    with tf32_products(torch.device("cuda", 0)):
        assert torch.backends.cuda.matmul.fp32_precision == "tf32"
    assert torch.backends.cuda.matmul.fp32_precision == before
    with tf32_products(torch.device("cpu")):
        assert torch.backends.cuda.matmul.fp32_precision == before
