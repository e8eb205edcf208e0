"""Choice and description of the device that the physics runs on."""

from __future__ import annotations

from typing import Any

import torch

from humoslope.errors import UserError


def find_device(backend: str, device: str) -> torch.device:
    """The device for a backend; a CUDA device always has its index.

    Args:
        backend: "auto", "native" or "warp".
        device: "auto", or a torch device. "auto" is CUDA where there is one, but the CPU for the native backend.

    Raises:
        UserError: If the device does not exist here or cannot run the backend.
    """
    if device == "auto":
        if backend == "native" or not torch.cuda.is_available():
            return torch.device("cpu")
        return torch.device("cuda", torch.cuda.current_device())
    try:
        where = torch.device(device)
    except RuntimeError:
        raise UserError(f"device '{device}' is not one torch knows; use 'auto', 'cpu' or 'cuda:0'.") from None
    if where.type not in ("cpu", "cuda"):
        raise UserError(f"device '{device}' cannot run the physics; use 'auto', 'cpu' or 'cuda:0'.")
    if where.type == "cpu":
        return torch.device("cpu")
    if backend == "native":
        raise UserError(f"the native physics runs on the CPU, not on '{device}'; use backend 'warp'.")
    if not torch.cuda.is_available():
        raise UserError(f"device '{device}' was asked for, but torch finds no CUDA here{_no_cuda()}; use device 'cpu'.")
    if where.index is None:
        return torch.device("cuda", torch.cuda.current_device())
    count = torch.cuda.device_count()
    if where.index >= count:
        raise UserError(f"device '{device}' was asked for, but the last CUDA device is 'cuda:{count - 1}'.")
    return where


def require_warp(where: torch.device) -> None:
    """Raises UserError unless MuJoCo-Warp sees the CUDA device that torch sees.

    Warp brings a CUDA of its own, which may need a newer driver than torch's.
    """
    import warp as wp

    wp.init()
    count: int = wp.get_cuda_device_count()
    if where.type != "cuda" or where.index < count:
        return
    runtime: Any = wp._src.context.runtime
    needed = runtime.min_driver_version
    found = wp.get_cuda_driver_version()
    if found is not None and needed is not None and found < needed:
        raise UserError(
            f"the NVIDIA driver is for CUDA {found[0]}.{found[1]}, and MuJoCo-Warp needs one for CUDA "
            f"{needed[0]}.{needed[1]}; update the driver, or use device 'cpu'."
        )
    raise UserError(f"torch sees '{where}', but MuJoCo-Warp sees {count} CUDA devices; use device 'cpu'.")


def describe_device(where: torch.device) -> str:
    """Name, memory and driver of a CUDA device; "CPU" otherwise."""
    if where.type != "cuda":
        return "CPU"
    import warp as wp

    properties = torch.cuda.get_device_properties(where)
    driver = wp.get_cuda_driver_version()
    told = f", driver for CUDA {driver[0]}.{driver[1]}" if driver else ""
    return f"{properties.name}, {properties.total_memory / 2**30:.0f} GiB{told}"


def _no_cuda() -> str:
    if torch.version.cuda is None:
        return " (it is installed without CUDA)"
    return f" (it needs an NVIDIA driver for CUDA {torch.version.cuda})"
