"""Checkpoints to evaluate, and the command line as a user meets it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from humoslope.cli import main
from humoslope.env import ManagerBasedRlEnv
from humoslope.learning.trainer import Trainer
from humoslope.presets import apply_preset
from humoslope.registry import build_task

TASK = "HumoSlope-Stage1-Unitree-G1"


@pytest.fixture(scope="session")
def untrained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint of an untrained actor, of a run with a harness."""
    cfg = build_task(TASK)
    apply_preset(cfg, "cpu")
    cfg.env.num_envs, cfg.env.sim.backend, cfg.env.sim.device = 4, "native", "cpu"
    cfg.agent.hidden_dims = (24, 16)
    trainer = Trainer(TASK, cfg, ManagerBasedRlEnv(cfg.env), None, Console(quiet=True))
    path = tmp_path_factory.mktemp("run") / "model_0.pt"
    trainer.iteration = 1
    trainer.save(path)
    return path


@pytest.fixture
def mistake(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a command that must end as a user's mistake; returns the one sentence it says."""

    def run(*arguments: str) -> str:
        assert main(list(arguments)) == 2
        said = capsys.readouterr().err
        assert said.startswith("humoslope: ")
        assert said.count("\n") == 1
        assert said.endswith((".\n", "?\n"))
        return said

    return run
