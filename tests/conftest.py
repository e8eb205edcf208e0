"""What every test rests on: one CPU thread, no deadlines, the registered content, real and pretended environments."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from hypothesis import settings
from torch import Tensor

from humoslope.cli import main
from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.managers import FiniteWatch, Log, Terms
from humoslope.registry import build_task, load_content

torch.set_num_threads(1)
os.environ.setdefault("OMP_NUM_THREADS", "1")  # in child processes, too: tests run side by side
settings.register_profile("humoslope", deadline=None, max_examples=50)  # no test depends on how fast the machine is
settings.load_profile("humoslope")


@pytest.fixture(scope="session", autouse=True)
def _content() -> None:
    load_content()


class FakeEnv(SimpleNamespace):
    """Worlds without physics: sizes, a clock, a log, and what a test gives them."""

    num_envs: int
    device = torch.device("cpu")
    step_dt = 0.02
    sim = SimpleNamespace(known_empty=lambda mask: False, known_rows=lambda mask: slice(None))  # as on a GPU

    def zeros(self, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        return torch.zeros(self.num_envs, *shape, dtype=dtype)

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        return torch.rand(self.num_envs, *shape) * (high - low) + low


@pytest.fixture(scope="session")
def make_env() -> Callable[..., FakeEnv]:
    """make_env(4, speed=...): a stand-in for an environment of four worlds, with these attributes."""

    def make(num_envs: int = 4, **attributes: object) -> FakeEnv:
        torch.manual_seed(0)
        cfg = SimpleNamespace(episode_length_s=10.0, curriculum=Terms())
        device = torch.device("cpu")
        defaults = {"cfg": cfg, "log": Log(device), "finite": FiniteWatch(num_envs, device)}
        return FakeEnv(num_envs=num_envs, **(defaults | attributes))

    return make


@pytest.fixture(scope="session")
def make_stage1() -> Callable[..., ManagerBasedRlEnv]:
    """make_stage1(8, change): the real Stage I on CPU physics, after `change(cfg)`."""

    def make(num_envs: int, change: Callable[[EnvCfg], None] = lambda cfg: None) -> ManagerBasedRlEnv:
        cfg = build_task("HumoSlope-Stage1-Unitree-G1").env
        cfg.num_envs = num_envs
        cfg.sim.backend = "native"
        change(cfg)
        return ManagerBasedRlEnv(cfg)

    return make


@pytest.fixture(scope="session")
def stage1_checkpoint() -> Path:
    """The shipped policy of Stage I, which walks."""
    return Path(__file__).parents[1] / "experiments" / "checkpoints" / "stage1.pt"


@pytest.fixture(scope="session")
def exported(stage1_checkpoint: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its export folder; not to be written into."""
    folder = tmp_path_factory.mktemp("export") / "stage1"
    assert main(["export", str(stage1_checkpoint), "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="session")
def mask() -> Callable[..., Tensor]:
    """mask(4, 1, 3): of four worlds, the second and the last."""

    def make(num_envs: int, *chosen: int) -> Tensor:
        result = torch.zeros(num_envs, dtype=torch.bool)
        result[list(chosen)] = True
        return result

    return make
