"""A step on torch's meta device: a tensor on the wrong device, or a value that the host would read, is an error there.

The guard against host syncs works on the CPU, where a missing `device=` goes unnoticed; on a GPU it would be an error.
"""

from __future__ import annotations

import traceback
from typing import Any

import mujoco
import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

import humoslope.env as env_module
from humoslope.env import ManagerBasedRlEnv
from humoslope.registry import build_task

META = torch.device("meta")
N = 16


class MetaSimulation:
    """Worlds without physics, whose tensors have shapes and a device but no values."""

    backend = "warp"

    def __init__(self, model: mujoco.MjModel, num_worlds: int) -> None:
        self.model, self.num_worlds, self.device = model, num_worlds, META
        self._data = mujoco.MjData(model)
        self._arrays: dict[tuple[str, str], Tensor] = {}

    def _array(self, kind: str, field: str, shape: tuple[int, ...]) -> Tensor:
        return self._arrays.setdefault((kind, field), torch.zeros(self.num_worlds, *shape, device=META))

    def read(self, field: str) -> Tensor:
        return self._array("reading", field, getattr(self._data, field).shape)

    def state(self, field: str) -> Tensor:
        return self._array("state", field, () if field == "time" else getattr(self._data, field).shape)

    def expand(self, field: str) -> Tensor:
        return self._array("model", field, getattr(self.model, field).shape)

    def recompute_constants(self) -> None:
        pass

    def step(self, n: int, mask: Tensor | None = None) -> None:
        pass

    def reset(self, *values: Tensor) -> None:
        assert {value.device for value in values} == {META}

    def known_empty(self, mask: Tensor) -> bool:
        return False

    def known_rows(self, mask: Tensor) -> slice:
        return slice(None)

    def diverged(self) -> Tensor:
        return torch.zeros(self.num_worlds, dtype=torch.bool, device=META)

    def warnings(self) -> list[str]:
        return []


class OnlyMeta(TorchDispatchMode):
    """Keeps the places at which a tensor was made on another device, and the number of operations."""

    def __init__(self) -> None:
        super().__init__()
        self.elsewhere: list[str] = []
        self.operations = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        self.operations += 1
        for tensor in result if isinstance(result, tuple | list) else (result,):
            if isinstance(tensor, Tensor) and tensor.device != META:
                self.elsewhere.append(f"{func} {tuple(tensor.shape)}\n{''.join(traceback.format_stack(limit=6)[:-1])}")
        return result


@pytest.fixture
def on_meta(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(env_module, "make_simulation", lambda model, num_worlds, **_: MetaSimulation(model, num_worlds))


@pytest.mark.parametrize(
    "task",
    [
        "HumoSlope-Stage1-Unitree-G1",
        "HumoSlope-Stage2-Unitree-G1",
        "URL-TerrainRelative-Unitree-G1",
        "Gallant-Unitree-G1",
        "UnitreeMjlab-Rough-Unitree-G1",
    ],
)
def test_all_of_a_step_happens_on_the_physics_device(on_meta: None, task: str) -> None:
    cfg = build_task(task).env
    cfg.num_envs = N
    env = ManagerBasedRlEnv(cfg)
    env.enable_terminal_observations()
    action = torch.zeros(N, env.robot.num_joints, device=META)
    env.step(action)
    with torch.inference_mode(), OnlyMeta() as guard:
        env.step(action)
    assert guard.elsewhere == [], guard.elsewhere[0]
    assert guard.operations > 300, "a whole step went by"


def test_a_tensor_without_a_device_is_found(on_meta: None) -> None:
    cfg = build_task("HumoSlope-Stage1-Unitree-G1").env
    cfg.num_envs = N
    env = ManagerBasedRlEnv(cfg)
    env.observers.append(lambda env: torch.zeros(3))
    with OnlyMeta() as guard:
        env.step(torch.zeros(N, env.robot.num_joints, device=META))
    assert len(guard.elsewhere) == 1
