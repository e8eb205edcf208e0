"""Memory of the machine: what is too large is refused before it is built, with the size that fits."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from humoslope.errors import UserError

if TYPE_CHECKING:
    import torch

MEMINFO = Path("/proc/meminfo")
STATM = Path("/proc/self/statm")
CGROUPS = (
    ("/sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"),
    ("/sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
)
"""Where the second and the first version of containers say what their limit is, what is used, and how much of that are
copies of files, which give way."""


def available() -> int | None:
    """Bytes that this process can still take: of the machine, its container and its own limit; None if unknown."""
    found = []
    for line in _read(MEMINFO).splitlines():
        name, _, value = line.partition(":")
        if name == "MemAvailable":
            found.append(int(value.split()[0]) * 1024)
    for folder, limit, use, files in CGROUPS:
        most, taken = (_read(Path(folder, name)).strip() for name in (limit, use))
        if most.isdigit() and taken.isdigit():
            kept = re.search(rf"^{files} (\d+)$", _read(Path(folder, "memory.stat")), re.MULTILINE)
            found.append(int(most) - int(taken) + (int(kept[1]) if kept else 0))
    if sys.platform != "win32":
        import resource

        most_address = resource.getrlimit(resource.RLIMIT_AS)[0]
        pages = _read(STATM).split()
        if most_address != resource.RLIM_INFINITY and pages:
            found.append(most_address - int(pages[0]) * resource.getpagesize())
    return max(0, min(found)) if found else None


def free_memory(device: torch.device) -> float:
    """Bytes that can still be taken on a device; infinite if unknown."""
    if device.type == "cuda":
        import torch

        return torch.cuda.mem_get_info(device)[0]
    room = available()
    return float("inf") if room is None else room


def require_memory(
    what: str, count: int, bytes_each: float, more: str = "", device: torch.device | None = None
) -> None:
    """Raises a `UserError` if `count` things of `bytes_each` do not fit into what is available.

    Args:
        what: Name of the number, such as "env.num_envs".
        more: What else would help, for the end of the message.
        device: Device that they are meant for; by default the CPU.
    """
    room = available() if device is None else free_memory(device)
    if room is None or count * bytes_each <= room:
        return
    fits = int(room // bytes_each)
    raise UserError(
        f"{what} is {count:,}, which needs {count * bytes_each / 2**30:.1f} GiB of memory; {room / 2**30:.1f} GiB are "
        f"free, enough for {fits:,}{more}."
    )


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii")
    except (OSError, ValueError):
        return ""
