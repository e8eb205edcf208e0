"""Batched physics: many worlds of one MuJoCo model behind one protocol, on the CPU or on a GPU."""

from __future__ import annotations

from typing import Literal

import mujoco
import torch

from humoslope.errors import UserError, unknown
from humoslope.sim.protocol import Simulation

__all__ = ["Simulation", "make_simulation"]

BACKENDS = ("auto", "native", "warp")


def make_simulation(
    model: mujoco.MjModel,
    num_worlds: int,
    backend: Literal["auto", "native", "warp"] = "auto",
    device: str = "auto",
    num_threads: int = 0,
    *,
    nconmax: int = 48,
    njmax: int = 192,
) -> Simulation:
    """Starts `num_worlds` copies of a compiled model.

    Args:
        model: Taken as it is now; later changes to it have no effect on the physics.
        num_worlds: N, at least 1.
        backend: "native" steps C MuJoCo on CPU threads, "warp" steps MuJoCo-Warp on CUDA (on the CPU only to compare
            the two: it is some thirty times slower there). "auto" takes warp if the device is CUDA, else native.
        device: A torch device. "auto" is CUDA where there is one, but the CPU for the native backend.
        num_threads: Threads of the native backend; 0 uses every logical CPU that the process may use.
        nconmax: Contacts the warp backend makes room for, per world on average; the native backend needs no such bound.
        njmax: Constraint rows the warp backend makes room for in each world.

    Raises:
        UserError: If the backend does not exist or cannot run on the device, or a number makes no sense.
    """
    if backend not in BACKENDS:
        raise unknown("physics backend", backend, BACKENDS)
    if num_worlds < 1:
        raise UserError(f"number of worlds is {num_worlds}; a simulation needs at least 1.")
    if num_threads < 0:
        raise UserError(f"number of threads is {num_threads}; it must be 0 (every CPU) or more.")
    for name, size in (("nconmax", nconmax), ("njmax", njmax)):
        if size < 1:
            raise UserError(f"{name} is {size}; the contact and constraint buffers need room for at least 1.")
    where = _device(backend, device)
    if backend == "native" or (backend == "auto" and where.type == "cpu"):
        from humoslope.sim.native import NativeSimulation  # keeps the GPU machine free of the CPU backend's thread pool

        return NativeSimulation(model, num_worlds, num_threads)
    from humoslope.sim.warp import WarpSimulation  # importing mujoco_warp takes seconds

    return WarpSimulation(model, num_worlds, where, nconmax, njmax)


def _device(backend: str, device: str) -> torch.device:
    if device == "auto":
        return torch.device("cuda" if backend != "native" and torch.cuda.is_available() else "cpu")
    try:
        where = torch.device(device)
    except RuntimeError:
        raise UserError(f"device '{device}' is not one torch knows; use 'auto', 'cpu' or 'cuda:0'.") from None
    if where.type not in ("cpu", "cuda"):
        raise UserError(f"device '{device}' cannot run the physics; use 'auto', 'cpu' or 'cuda:0'.")
    if where.type == "cuda":
        if backend == "native":
            raise UserError(f"the native physics runs on the CPU, not on '{device}'; use backend 'warp'.")
        if not torch.cuda.is_available():
            raise UserError(f"device '{device}' was asked for, but torch finds no CUDA here; use device 'cpu'.")
        count = torch.cuda.device_count()
        if where.index is not None and where.index >= count:
            raise UserError(f"device '{device}' was asked for, but the last CUDA device is 'cuda:{count - 1}'.")
    return where
