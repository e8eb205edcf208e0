"""Processors and threads. torch is imported only where it is asked, since exports run without it."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from typing import ParamSpec, TypeVar

SHARE = "HUMOSLOPE_THREADS"
"""Environment variable with the most CPUs that a process is to use, for processes that share a machine."""


def usable_cores() -> int:
    """Returns the number of logical CPUs that a batch system or `taskset` leaves to this process, or its `SHARE`.
    Processes that torchrun has started side by side have an equal part of them each."""
    # macOS and Windows do not say more than how many there are.
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    there = max(there // (_positive("LOCAL_WORLD_SIZE") or 1), 1)
    return min(there, _positive(SHARE) or there)


def _positive(variable: str) -> int:
    """The positive whole number in an environment variable; 0 if there is none."""
    text = os.environ.get(variable, "")
    return int(text) if text.isdecimal() else 0


def thread_advice() -> str | None:
    """Returns a sentence for the start of a training if torch has more threads than the machine has idle cores.

    A thread that has to wait for a busy core delays every operation that is split over threads: on two cores with one
    busy, PPO makes about half as many steps per core-second with two threads as with one. The number is advice and not
    set here, since sums are rounded differently with another number of threads: a command with its seed must give the
    same numbers whatever else the machine does. With OMP_NUM_THREADS set the user has chosen, and there is no advice.
    """
    if os.environ.get("OMP_NUM_THREADS") or not hasattr(os, "getloadavg"):
        return None
    import torch

    load, cores, threads = os.getloadavg()[0], os.cpu_count() or 1, torch.get_num_threads()
    idle = max(round(cores - load), 1)
    if threads <= idle:
        return None
    return (
        f"The machine is busy (load {load:.1f} on {cores} cores) and torch uses {threads} threads, which would wait "
        f"for each other; training is probably faster with OMP_NUM_THREADS={idle}."
    )


P = ParamSpec("P")
R = TypeVar("R")


def on_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator for a function inside which torch uses a single thread.

    For many operations on small tensors: waking a second thread takes longer than the work that it takes over.
    """
    import torch

    @functools.wraps(function)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> R:
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            return function(*args, **kwargs)
        finally:
            torch.set_num_threads(threads)

    return wrapper
