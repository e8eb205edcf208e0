"""Processors that a process may use, and threads that make sense on them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable

import pytest
import torch

from humoslope.cpu import thread_advice, usable_cores


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="processors can be kept from a process on Linux alone")
def test_processors_that_are_kept_from_it_do_not_count() -> None:
    code = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
    code += "from humoslope.cpu import usable_cores; print(usable_cores())"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert int(told) == 1


def test_there_is_at_least_one(monkeypatch: pytest.MonkeyPatch) -> None:
    assert usable_cores() >= 1
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert usable_cores() == 1


def test_processes_that_were_started_side_by_side_share_what_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: range(8), raising=False)
    monkeypatch.setenv("LOCAL_WORLD_SIZE", "3")  # as torchrun sets it
    assert usable_cores() == 2
    monkeypatch.setenv("HUMOSLOPE_THREADS", "1")
    assert usable_cores() == 1
    monkeypatch.setenv("LOCAL_WORLD_SIZE", "16")
    monkeypatch.setenv("HUMOSLOPE_THREADS", "nonsense")
    assert usable_cores() == 1


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """machine(load, cores, threads) sets what the process sees."""
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)

    def pretend(load: float, cores: int, threads: int) -> None:
        monkeypatch.setattr(os, "getloadavg", lambda: (load, 0.0, 0.0), raising=False)
        monkeypatch.setattr(os, "cpu_count", lambda: cores)
        monkeypatch.setattr(torch, "get_num_threads", lambda: threads)

    return pretend


@pytest.mark.parametrize(
    ("load", "cores", "threads", "advised"),
    [
        (0.0, 2, 2, None),
        (0.4, 2, 2, None),
        (1.1, 2, 2, 1),
        (6.0, 2, 2, 1),  # never none at all
        (6.0, 2, 1, None),
        (10.0, 64, 32, None),  # as many are idle
        (40.0, 64, 32, 24),
    ],
)
def test_fewer_threads_are_advised_where_fewer_cores_are_idle(
    machine: Callable[..., None], load: float, cores: int, threads: int, advised: int | None
) -> None:
    machine(load, cores, threads)
    said = thread_advice()
    assert (said is None) == (advised is None)
    assert advised is None or f"OMP_NUM_THREADS={advised}." in str(said)


def test_a_user_who_has_chosen_gets_no_advice(machine: Callable[..., None], monkeypatch: pytest.MonkeyPatch) -> None:
    machine(6.0, 2, 2)
    assert thread_advice() is not None
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    assert thread_advice() is None


def test_without_a_load_average_there_is_no_advice(
    machine: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    machine(6.0, 2, 2)
    monkeypatch.delattr(os, "getloadavg")
    assert thread_advice() is None
