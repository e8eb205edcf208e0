"""Runs so small that they take a second: eight worlds on a small terrain, and networks of two narrow layers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from humoslope.cli import main

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
