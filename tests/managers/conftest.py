"""A stand-in for the environment: managers only need its sizes, its clock, its log and what their terms read."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

from humoslope.managers import Log, Terms


class FakeEnv(SimpleNamespace):
    """Worlds without physics; attributes are added by each test."""

    num_envs: int
    device = torch.device("cpu")
    step_dt = 0.02

    def zeros(self, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        return torch.zeros(self.num_envs, *shape, dtype=dtype)

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        return torch.rand(self.num_envs, *shape) * (high - low) + low


@pytest.fixture
def make_env() -> Callable[..., FakeEnv]:
    def make(num_envs: int = 4, **attributes: object) -> FakeEnv:
        torch.manual_seed(0)
        cfg = SimpleNamespace(episode_length_s=10.0, curriculum=Terms())
        return FakeEnv(num_envs=num_envs, cfg=cfg, log=Log(torch.device("cpu")), **attributes)

    return make


@pytest.fixture
def mask() -> Callable[..., Tensor]:
    """mask(4, 1, 3): of four worlds, the second and the last."""

    def make(num_envs: int, *chosen: int) -> Tensor:
        result = torch.zeros(num_envs, dtype=torch.bool)
        result[list(chosen)] = True
        return result

    return make
