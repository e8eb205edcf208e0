"""Memory that is free on a device."""

from __future__ import annotations

import os
from pathlib import Path

import torch

CGROUP = Path("/sys/fs/cgroup")


def free_memory(device: torch.device) -> int:
    """Bytes that can still be allocated on a device: on a GPU its free memory; on a CPU what the kernel says is
    available, or what a container's limit leaves, whichever is less."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    return int(min(_available(), _below_limit()))


def _available() -> int:
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))
    except (OSError, StopIteration):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")  # not Linux: all there is


def _below_limit() -> float:
    """What the limit of the control group leaves, bytes; infinite if there is none."""
    try:
        limit, used = ((CGROUP / name).read_text(encoding="ascii").strip() for name in ("memory.max", "memory.current"))
        stat = dict(line.split() for line in (CGROUP / "memory.stat").read_text(encoding="ascii").splitlines())
        return int(limit) - int(used) + int(stat["inactive_file"]) if limit != "max" else float("inf")
    except (OSError, ValueError, KeyError):
        return float("inf")
