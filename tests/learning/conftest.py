"""Runs so small that they take a second: eight worlds on a small terrain, and networks of two narrow layers."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from functools import cache
from pathlib import Path

import pytest
from rich.console import Console

from humoslope.cli import main
from humoslope.cli.options import parse
from humoslope.cli.train import TrainArgs
from humoslope.env import ManagerBasedRlEnv
from humoslope.learning.distributed import Processes
from humoslope.learning.rng import seed_everything
from humoslope.learning.trainer import Trainer
from humoslope.registry import TaskCfg

TASK = "HumoSlope-Stage1-Unitree-G1"
TINY = [
    *("--preset", "cpu", "--env.num-envs", "8", "--env.sim.device", "cpu"),
    *("--env.scene.terrain.levels", "3", "--env.scene.terrain.num-columns", "9"),
    *("--agent.num-steps-per-env", "4", "--agent.num-mini-batches", "2", "--agent.num-learning-epochs", "1"),
    *("--agent.hidden-dims", "16", "16", "--agent.save-interval", "1", "--agent.no-mixed-precision"),
    # An entropy bonus that falls until the last iteration is none of rsl_rl's, and another one where more are added.
    *("--agent.final-entropy-coef", "None"),
]


@pytest.fixture(scope="session")
def task() -> str:
    return TASK


@pytest.fixture(scope="session")
def tiny() -> list[str]:
    """Options of a tiny run."""
    return TINY


@pytest.fixture(scope="session")
def tiny_cfg() -> Callable[..., TaskCfg]:
    """tiny_cfg("--agent.gamma", "0.5"): the configuration of a tiny run with these options, to change at will."""

    @cache
    def parsed(*options: str) -> TaskCfg:
        return parse(TrainArgs(), TASK, [*TINY, *options])[0]

    return lambda *options: deepcopy(parsed(*options))


@pytest.fixture(scope="session")
def make_trainer(tiny_cfg: Callable[..., TaskCfg]) -> Callable[..., Trainer]:
    """make_trainer("--agent.gamma", "0.5"): the trainer of a tiny run as it begins, without a folder."""

    def make(*options: str) -> Trainer:
        cfg = tiny_cfg(*options)
        seed_everything(cfg.env.seed)
        return Trainer(TASK, cfg, ManagerBasedRlEnv(cfg.env), None, Console(quiet=True))

    return make


@pytest.fixture(scope="session")
def shared_env(tiny_cfg: Callable[..., TaskCfg]) -> ManagerBasedRlEnv:
    return ManagerBasedRlEnv(tiny_cfg().env)


@pytest.fixture(scope="session")
def on_shared_env(tiny_cfg: Callable[..., TaskCfg], shared_env: ManagerBasedRlEnv) -> Callable[..., Trainer]:
    """on_shared_env("--agent.gamma", "0.5"): a new trainer, but on an environment that others may have stepped before.

    Options are those of the agent; `seed_offset` is added to the seed, for other random weights.
    """

    def make(*options: str, processes: Processes | None = None, seed_offset: int = 0) -> Trainer:
        assert not any(option.startswith("--env.") for option in options)
        cfg = tiny_cfg(*options)
        cfg.env.seed += seed_offset
        seed_everything(cfg.env.seed)
        return Trainer(TASK, cfg, shared_env, None, Console(quiet=True), processes)

    return make


@pytest.fixture(scope="session")
def train() -> Callable[..., Path]:
    """Trains a tiny run to its end; returns its folder."""

    def run(run_dir: Path, *options: str, code: int = 0) -> Path:
        assert main(["train", TASK, "--run-dir", str(run_dir), *TINY, *options]) == code
        return run_dir

    return run


@pytest.fixture(scope="session")
def finished(train: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run of three iterations; not to be written into."""
    return train(tmp_path_factory.mktemp("runs") / "finished", "--agent.max-iterations", "3")
