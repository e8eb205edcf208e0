"""An environment without physics."""

from __future__ import annotations

from types import SimpleNamespace

import torch
from torch import Tensor


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
