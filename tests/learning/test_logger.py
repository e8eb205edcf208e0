"""Curves to Weights & Biases, with a stand-in for its package."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rsl_rl.utils import wandb_log_writer

from humoslope.errors import UserError
from humoslope.learning.logger import CurveWriter
from humoslope.registry import TaskCfg, build_task


@pytest.fixture
def cfg() -> TaskCfg:
    cfg = build_task("HumoSlope-Stage1-Unitree-G1")
    cfg.agent.logger, cfg.agent.wandb_project = "wandb", "slopes"
    return cfg


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, Any]]:
    """stand_in(init): a package whose `init` does this; returns what was sent."""

    def make(init: Callable[..., None] = lambda **options: None) -> dict[str, Any]:
        sent: dict[str, Any] = {}

        def log(values: dict[str, float], step: int) -> None:
            sent.setdefault("points", []).append((step, values))

        def begin(**options: Any) -> None:
            init(**options)
            sent.update(options)

        def configure(values: dict[str, Any]) -> None:
            sent["config"].update(values)

        config = SimpleNamespace(update=configure)
        package = SimpleNamespace(init=begin, log=log, config=config, finish=lambda: sent.update(finished=True))
        monkeypatch.setitem(sys.modules, "wandb", package)
        monkeypatch.setattr(wandb_log_writer, "wandb", package)
        return sent

    return make


def test_a_refusal_is_one_sentence_with_what_helps(tmp_path: Path, cfg: TaskCfg, stand_in: Callable[..., Any]) -> None:
    def refuse(**options: Any) -> None:
        raise RuntimeError("api_key not configured (no-tty).\ncall wandb.login()")

    stand_in(refuse)
    with pytest.raises(UserError) as caught:
        CurveWriter(tmp_path, cfg)
    assert str(caught.value) == (
        "Weights & Biases does not begin: api_key not configured (no-tty); log in with 'wandb login', or set "
        "WANDB_MODE=offline."
    )


def test_a_run_is_sent_with_its_configuration_and_its_curves(
    tmp_path: Path, cfg: TaskCfg, stand_in: Callable[..., Any]
) -> None:
    sent = stand_in()
    curves = CurveWriter(tmp_path / "run_7", cfg)
    curves.write(3, {"Train/reward": 1.5})
    curves.close()
    assert (sent["project"], sent["name"], sent["finished"]) == ("slopes", "run_7", True)
    assert sent["config"]["env"]["rewards"]["zmp"]["weight"] == cfg.env.rewards.zmp.weight
    assert sent["config"]["agent"]["num_steps_per_env"] == cfg.agent.num_steps_per_env
    assert sent["points"] == [(3, {"Train/reward": 1.5})]
