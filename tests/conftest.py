"""What every test rests on: one CPU thread, no deadlines, the registered content, real and pretended environments."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest

# The libraries are imported by those who need them: where several processes share the tests, one only hands these out,
# and the others start when it has read this file.
if TYPE_CHECKING:
    from torch import Tensor

    from humoslope.env import EnvCfg, ManagerBasedRlEnv
    from tests.fake_env import FakeEnv

os.environ.setdefault("OMP_NUM_THREADS", "1")  # in child processes, too: tests run side by side


def pytest_collection(session: pytest.Session) -> None:
    if session.config.getoption("numprocesses", None):
        return
    import torch
    from hypothesis import settings

    torch.set_num_threads(1)
    settings.register_profile("humoslope", deadline=None, max_examples=50)  # no test depends on how fast the machine is
    settings.load_profile("humoslope")


@pytest.fixture(scope="session", autouse=True)
def _content() -> None:
    from humoslope.registry import load_content

    load_content()


@pytest.fixture(scope="session")
def make_env() -> Callable[..., FakeEnv]:
    """make_env(4, speed=...): a stand-in for an environment of four worlds, with these attributes."""

    import torch

    from humoslope.managers import FiniteWatch, Log, Terms
    from tests.fake_env import FakeEnv

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

    from humoslope.env import ManagerBasedRlEnv
    from humoslope.registry import build_task

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
def shared_operators() -> Iterator[None]:
    """For several exports. Torch compiles its 500 operators anew for each, which takes longer than the export."""
    from torch.onnx._internal.exporter._registration import ONNXRegistry

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ONNXRegistry, "from_torchlib", staticmethod(cache(ONNXRegistry.from_torchlib)))
        yield


@pytest.fixture(scope="session")
def exported(stage1_checkpoint: Path, shared_operators: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its export folder; not to be written into."""
    from humoslope.cli import main

    common = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        common = common.parent  # of all processes that share the tests
    folder = common / "exported-stage1"
    if not folder.exists():
        own = tmp_path_factory.mktemp("export") / "stage1"
        assert main(["export", str(stage1_checkpoint), "--out", str(own)]) == 0
        with suppress(OSError):  # another process was faster
            own.rename(folder)
    return folder


@pytest.fixture(scope="session")
def mask() -> Callable[..., Tensor]:
    """mask(4, 1, 3): of four worlds, the second and the last."""
    import torch

    def make(num_envs: int, *chosen: int) -> Tensor:
        result = torch.zeros(num_envs, dtype=torch.bool)
        result[list(chosen)] = True
        return result

    return make
