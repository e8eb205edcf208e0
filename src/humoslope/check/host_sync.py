"""Detection of operations that make the host wait for the device."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from humoslope.check.finding import Finding
from humoslope.env import ManagerBasedRlEnv

aten = torch.ops.aten

ANSWERS = {aten._linalg_check_errors, aten._local_scalar_dense, aten.item, aten.is_nonzero, aten.equal, aten.allclose}
"""Operators whose result is a number on the host."""

SIZED_BY_VALUES = {
    aten.nonzero,
    aten.masked_select,
    aten._unique,
    aten._unique2,
    aten.unique_dim,
    aten.unique_consecutive,
    aten.bincount,
}
"""Operators whose result has a size that depends on values."""

INDEXING = {aten.index, aten.index_put, aten.index_put_, aten._index_put_impl_}

FROM_HOST = {torch.tensor, torch.as_tensor, torch.from_numpy, Tensor.new_tensor}
TO_HOST = {Tensor.cpu, Tensor.numpy, Tensor.tolist, Tensor.item, Tensor.__bool__, Tensor.__int__, Tensor.__float__}

WARM_UP = 3
"""Steps before syncs are refused: the first ones allocate and capture."""


class HostSync(AssertionError):
    """An operation that makes the host wait for the device."""


class NoHostSync(TorchDispatchMode):
    """Refuses, on the CPU, operators that would make the host wait for a GPU, and copies between the two.

    Attributes:
        exempt: Whether everything is allowed, as while the simulation passes arrays to NumPy.
    """

    def __init__(self) -> None:
        super().__init__()
        self.exempt = False
        self.calls = _NoHostCalls(self)

    def __enter__(self) -> NoHostSync:
        super().__enter__()
        self.calls.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.calls.__exit__(kind, error, trace)
        super().__exit__(kind, error, trace)

    def __torch_dispatch__(self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        if not self.exempt and self._waits(func.overloadpacket, args, kwargs):
            raise HostSync(f"{func} makes the host wait for the device")
        return func(*args, **kwargs)

    @staticmethod
    def _waits(operator: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> bool:
        if operator in ANSWERS or operator in SIZED_BY_VALUES:
            return True
        if operator is aten.repeat_interleave:
            return kwargs.get("output_size") is None
        if operator in INDEXING:
            return any(i is not None and i.dtype in (torch.bool, torch.uint8) for i in args[1])
        if operator is aten._to_copy:
            return bool(kwargs.get("device", args[0].device) != args[0].device)
        return bool(operator is aten.copy_ and args[0].device != args[1].device)


class _NoHostCalls(TorchFunctionMode):
    """Refuses calls that copy between host and device; on the CPU they reach no operator."""

    def __init__(self, guard: NoHostSync) -> None:
        super().__init__()
        self._guard = guard

    def __torch_function__(self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None) -> Any:
        if not self._guard.exempt and (func in FROM_HOST or func in TO_HOST or _indexes_by_a_list(func, args)):
            raise HostSync(f"{func} copies between host and device")
        return func(*args, **(kwargs or {}))


def _indexes_by_a_list(func: Any, args: tuple[Any, ...]) -> bool:
    """True for `x[:, [2, 5]]`: the list becomes a tensor on the host, which is copied to the device each time."""
    if func not in (Tensor.__getitem__, Tensor.__setitem__):
        return False
    places = args[1] if isinstance(args[1], tuple) else (args[1],)
    return any(isinstance(place, (list, tuple, np.ndarray)) for place in places)


@contextmanager
def no_host_sync(env: ManagerBasedRlEnv) -> Iterator[None]:
    """Refuses host syncs of an environment on the CPU, except where its physics passes arrays to NumPy."""
    guard = NoHostSync()

    def exempted(method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any) -> Any:
            before, guard.exempt = guard.exempt, True
            try:
                return method(*args)
            finally:
                guard.exempt = before

        return call

    names = ("step", "reset", "diverged", "known_empty", "known_rows")
    for name in names:
        setattr(env.sim, name, exempted(getattr(env.sim, name)))
    try:
        with guard:
            yield
    finally:
        for name in names:
            delattr(env.sim, name)


def check_host_sync(env: ManagerBasedRlEnv, steps: int) -> list[Finding]:
    """Steps an environment with random actions while host syncs are errors."""
    actions = [0.8 * torch.randn(env.num_envs, env.robot.num_joints, device=env.device) for _ in range(WARM_UP + steps)]
    found = "none"
    with torch.inference_mode():
        for action in actions[:WARM_UP]:
            env.step(action)
        try:
            with _cuda_syncs_refused() if env.device.type == "cuda" else no_host_sync(env):
                for action in actions[WARM_UP:]:
                    env.step(action)
        except (HostSync, RuntimeError) as error:
            if not isinstance(error, HostSync) and "synchroniz" not in str(error):
                raise
            found = str(error).splitlines()[0]
    return [Finding(f"host syncs in {steps} x env.step", found, "none", found == "none")]


@contextmanager
def _cuda_syncs_refused() -> Iterator[None]:
    torch.cuda.set_sync_debug_mode("error")
    try:
        yield
    finally:
        torch.cuda.set_sync_debug_mode("default")
