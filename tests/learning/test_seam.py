"""Learners from outside are trained, stopped, resumed, evaluated and exported by the same verbs as PPO."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from rich.console import Console

from humoslope import registry
from humoslope.cli import main
from humoslope.cli.options import parse
from humoslope.cli.train import TrainArgs
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.evaluation.report.curve import read_curves
from humoslope.learning import checkpoint
from humoslope.learning.config import AgentCfg
from humoslope.learning.logger import ProgressLine
from humoslope.learning.policy import load_actor, spec_of
from humoslope.learning.rng import seed_everything
from humoslope.learning.trainer import Trainer
from humoslope.registry import TaskCfg
from tests.learning import toys

TINY = [
    *("--preset", "cpu", "--env.num-envs", "8", "--env.sim.device", "cpu"),
    *("--env.scene.terrain.levels", "3", "--env.scene.terrain.num-columns", "9"),
    *("--agent.num-steps-per-env", "4", "--agent.save-interval", "1"),
]
TASKS = ["Toy-Td3", "Toy-Image"]

pytestmark = pytest.mark.usefixtures("shared_operators")


@pytest.fixture(scope="module", autouse=True)
def _registered() -> Iterator[None]:
    """The toys are tasks while these tests run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(registry, "_tasks", dict(registry._tasks))
        registry.task("Toy-Td3")(toys.toy_td3)
        registry.task("Toy-Image")(toys.toy_image)
        yield


@pytest.fixture(scope="module", params=TASKS)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def run(name: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two iterations."""
    folder = tmp_path_factory.mktemp(name) / "run"
    assert main(["train", name, "--run-dir", str(folder), *TINY, "--agent.max-iterations", "2"]) == 0
    return folder


@pytest.fixture(scope="module")
def cfg(name: str) -> TaskCfg:
    """Of a run of another seed; not to be written into."""
    return parse(TrainArgs(), name, [*TINY, "--env.seed", "9"])[0]


@pytest.fixture(scope="module")
def env(cfg: TaskCfg) -> ManagerBasedRlEnv:
    return ManagerBasedRlEnv(cfg.env)


@pytest.fixture
def trainer(name: str, cfg: TaskCfg, env: ManagerBasedRlEnv) -> Trainer:
    """A new trainer, on an environment that others had before."""
    seed_everything(cfg.env.seed)
    return Trainer(name, cfg, env, None, Console(quiet=True))


def test_the_type_of_the_agent_decides_which_learner_trains(trainer: Trainer, name: str) -> None:
    assert type(trainer.learner) is {"Toy-Td3": toys.ToyTd3, "Toy-Image": toys.ToyImage}[name]


def test_training_logs_its_curves_and_moves_the_policy(run: Path, name: str) -> None:
    curves = read_curves(run)
    assert list(curves["Perf/total_steps"].items()) == [(0, 32.0), (1, 64.0)]
    assert len(curves["Loss/critic" if name == "Toy-Td3" else "Loss/size"]) == 2
    first, second = (checkpoint.load(run / f"model_{i}.pt")["policy"]["weights"] for i in range(2))
    assert any(not torch.equal(first[key], second[key]) for key in first)


def test_a_signal_stops_it_with_a_checkpoint_and_it_resumes(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = ProgressLine.show

    def interrupt(self: ProgressLine, iteration: int, values: dict[str, float]) -> None:
        shown(self, iteration, values)
        if iteration == 1:
            os.kill(os.getpid(), signal.SIGTERM)

    folder = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(ProgressLine, "show", interrupt)
        assert main(["train", name, "--run-dir", str(folder), *TINY, "--agent.max-iterations", "1000"]) == 143
    assert checkpoint.latest(folder).name == "model_1.pt"
    assert main(["train", name, "--resume", str(folder), "--agent.max-iterations", "4"]) == 0
    state = checkpoint.load(folder / "model_3.pt", name)
    assert state["learner"]["taken"] == 16  # four steps in each of four iterations
    assert state["total_steps"] == 128


def test_resuming_is_exact_for_everything_but_the_episodes(run: Path, trainer: Trainer) -> None:
    trainer.resume(run / "model_1.pt")
    state = checkpoint.load(run / "model_1.pt")
    for key, value in state["policy"]["weights"].items():
        assert torch.equal(trainer.learner.policy.state_dict()[key], value)
    assert torch.equal(torch.get_rng_state(), state["rng"]["torch"])


def test_the_checkpoint_alone_rebuilds_the_policy(
    run: Path, name: str, env: ManagerBasedRlEnv, trainer: Trainer
) -> None:
    actor = load_actor(run / "model_1.pt", env, name)
    trainer.resume(run / "model_1.pt")
    obs = env.get_observations()
    assert torch.equal(actor(obs), trainer.learner.policy.eval()(obs))
    assert spec_of(checkpoint.load(run / "model_1.pt")) == trainer.learner.spec


def test_it_is_measured_on_ramps_and_on_the_track(run: Path) -> None:
    assert main(["ramps", str(run), "--starts", "1", "--seconds", "0.1", "--grades", "0", "10"]) == 0
    assert json.loads((run / "model_1.ramps.json").read_text())["checkpoint"]["iteration"] == 1
    tiny = ["--trials", "1", "--grades", "0", "--timeout-s", "0.1"]
    assert main(["evaluate", str(run), *tiny]) == 0
    assert (run / "model_1.heldout.json").is_file()
    assert main(["record", str(run), "--terrain", "ramp-up", "--grade", "5", "--seconds", "0.1"]) == 0


def test_it_is_exported(run: Path, name: str) -> None:
    assert main(["export", str(run)]) == 0
    assert (run / "model_1.export" / "exported" / "policy.onnx").is_file()


def test_terminal_observations_differ_from_the_next_ones_only_where_an_episode_ended() -> None:
    short, _ = parse(TrainArgs(), "Toy-Td3", [*TINY, "--env.episode-length-s", "0.1"])
    trainer = Trainer("Toy-Td3", short, ManagerBasedRlEnv(short.env), None, Console(quiet=True))
    trainer.start_episodes()
    for _ in range(3):
        trainer.iterate()  # `take` asserts the rest
    assert isinstance(trainer.learner, toys.ToyTd3)
    assert trainer.learner.terminal_differed > 0


def test_an_agent_without_a_learner_is_refused(name: str, cfg: TaskCfg, env: ManagerBasedRlEnv) -> None:
    with pytest.raises(UserError, match=r"agent AgentCfg has no learner; define build\(env\)"):
        Trainer(name, replace(cfg, agent=AgentCfg()), env, None, Console(quiet=True))
