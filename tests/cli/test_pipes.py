"""A pipe that nobody reads: verbs that only print end with a code of their own, others finish; none has a traceback."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable

import pytest

from humoslope.cli import main
from tests.evaluation import made_up

TASK = "HumoSlope-Stage1-Unitree-G1"


@pytest.fixture
def unread(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str]]:
    """Runs a command whose output is a closed pipe; returns its exit code and what it says on stderr."""

    def run(*arguments: str) -> tuple[int, str]:
        reading, writing = os.pipe()
        os.close(reading)
        with os.fdopen(writing, "w") as nobody, monkeypatch.context() as patch:
            patch.setattr(sys, "stdout", nobody)
            try:
                code = main(list(arguments))
            except SystemExit as stop:
                code = int(stop.code or 0)
            nobody.flush()  # as Python does when it ends, and complains
        return code, capsys.readouterr().err

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
