"""How many processors there are to work with."""

from __future__ import annotations

import os


def usable_cores() -> int:
    """Logical CPUs that this process may use: without those that a batch system or `taskset` keeps from it."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1  # macOS and Windows tell no more
