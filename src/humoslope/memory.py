"""Memory of the machine: what is too large is refused before it is built, with the size that fits."""

from __future__ import annotations

import sys
from pathlib import Path

from humoslope.errors import UserError

MEMINFO = Path("/proc/meminfo")
STATM = Path("/proc/self/statm")
CGROUPS = (
    (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")),
    (Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"), Path("/sys/fs/cgroup/memory/memory.usage_in_bytes")),
)
"""Limit and use of a container, in the second and in the first version."""


def available() -> int | None:
    """Bytes that this process can still take: of the machine, its container and its own limit; None if unknown."""
    found = []
    for line in _read(MEMINFO).splitlines():
        name, _, value = line.partition(":")
        if name == "MemAvailable":
            found.append(int(value.split()[0]) * 1024)
    for limit, use in CGROUPS:
        most, taken = _read(limit).strip(), _read(use).strip()
        if most.isdigit() and taken.isdigit():
            found.append(int(most) - int(taken))
    if sys.platform != "win32":
        import resource

        most_address = resource.getrlimit(resource.RLIMIT_AS)[0]
        pages = _read(STATM).split()
        if most_address != resource.RLIM_INFINITY and pages:
            found.append(most_address - int(pages[0]) * resource.getpagesize())
    return max(0, min(found)) if found else None


def require_memory(what: str, count: int, bytes_each: float, more: str = "") -> None:
    """Raises a `UserError` if `count` things of `bytes_each` do not fit into what is available.

    Args:
        what: Name of the number, such as "env.num_envs".
        more: What else would help, for the end of the message.
    """
    room = available()
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
