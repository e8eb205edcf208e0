"""A pipe that nobody reads: verbs that only print end with a code of their own, others finish; none has a traceback."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from humoslope.cli import main
from tests.evaluation import made_up

TASK = "HumoSlope-Stage1-Unitree-G1"


@pytest.fixture
def unread(tmp_path: Path) -> Callable[..., tuple[int, str]]:
    """Runs a command in a child of this process whose output is a closed pipe; returns its exit code and what it says
    on stderr."""

    def run(*arguments: str) -> tuple[int, str]:
        child, errors = os.fork(), tmp_path / "stderr"
        if child == 0:
            code = 120  # Python's own where it cannot write what is left
            try:
                reading, writing = os.pipe()
                os.close(reading)
                os.dup2(writing, 1)
                os.dup2(os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
                sys.stdout, sys.stderr = (os.fdopen(number, "w", closefd=False) for number in (1, 2))
                code = main(list(arguments))
                sys.stdout.flush()
            except SystemExit as stop:
                sys.stdout.flush()
                code = int(stop.code or 0)
            finally:
                sys.stderr.flush()
                os._exit(code)
        _, status = os.waitpid(child, 0)
        return os.waitstatus_to_exitcode(status), errors.read_text()

    return run


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["list"],
        ["list", "--help"],
        ["train", "--help"],
        ["train", TASK, "--help"],
        ["ramps", "--help"],
        ["table", "1", "{results}"],
        ["table", "cells", "{results}"],
    ],
    ids=" ".join,
)
def test_what_only_prints_ends_with_141(unread, tmp_path, arguments) -> None:
    results = made_up.write(tmp_path, "held", made_up.report())
    assert unread(*(word.format(results=results) for word in arguments)) == (141, "")


def test_what_writes_files_finishes(unread, tmp_path, untrained) -> None:
    shutil.copy(untrained, tmp_path / "model_0.pt")
    walk = ["--starts", "1", "--seconds", "0.1", "--grades", "0"]
    assert unread("ramps", str(tmp_path / "model_0.pt"), *walk) == (0, "")
    assert (tmp_path / "model_0.ramps.json").is_file()
    assert unread("terrain", "flat", "--out", str(tmp_path / "flat.png")) == (0, "")
    assert (tmp_path / "flat.png").is_file()


def test_a_mistake_is_one_whether_or_not_anybody_reads(unread) -> None:
    code, said = unread("train", TASK, "--env.num-envs", "0")
    assert code == 2
    assert said.startswith("humoslope: env.num_envs is 0; ")
    assert said.count("\n") == 1
