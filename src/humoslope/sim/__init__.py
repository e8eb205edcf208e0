"""Batched physics: many worlds of one MuJoCo model behind one protocol, on the CPU or on a GPU."""

from __future__ import annotations

import sys
from typing import Literal

import mujoco

from humoslope.errors import UserError, unknown
from humoslope.sim.device import describe_device, find_device, require_warp
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
        model: Copied; later changes to it have no effect on the physics.
        num_worlds: N, at least 1.
        backend: "native" steps C MuJoCo on CPU threads, "warp" steps MuJoCo-Warp on CUDA (on the CPU it is there to
            compare the two, and slower than native). "auto" takes warp if the device is CUDA, else native.
        device: A torch device. "auto" is CUDA where there is one, but the CPU for the native backend.
        num_threads: Threads of the native backend, which alone has any; 0 uses every CPU that the process may use.
        nconmax: Contacts the warp backend makes room for, per world on average; the native backend needs no such bound.
        njmax: Constraint rows the warp backend makes room for in each world.

    Raises:
        UserError: If the backend does not exist or cannot run on the device, a number is impossible, or the device has
            too little memory for the worlds.
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
    where = find_device(backend, device)
    if backend == "native" or (backend == "auto" and where.type == "cpu"):
        from humoslope.sim.native import NativeSimulation  # keeps the GPU machine free of the CPU backend's thread pool

        return NativeSimulation(model, num_worlds, num_threads)
    from humoslope.sim.warp import WarpSimulation  # importing mujoco_warp takes seconds

    require_warp(where)
    if where.type == "cuda":
        # The kernels are compiled inside the first capture, in silence.
        print(
            f"Preparing the physics on {where} ({describe_device(where)}). "
            "Its kernels are compiled once, which takes some minutes; later starts take seconds.",
            file=sys.stderr,
            flush=True,
        )
    return WarpSimulation(model, num_worlds, where, nconmax, njmax)
