"""The number of processors that a process takes for its own."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from humoslope.cpu import usable_cores


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
