"""`humoslope accept`: a table, a JSON, and an exit code that tells whether all demands are met."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest

from humoslope.cli import main
from humoslope.deploy.gait import Gait
from humoslope.deploy.player import Trial

QUICK = ("--trials", "1", "--seconds", "5.5", "--processes", "1")


def test_the_exit_code_tells_whether_the_demands_are_met(
    exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "found"
    arguments = ["accept", str(exported), *QUICK, "--out", str(out), "--demands", "double-support", "step-rate"]
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 1
    printed = capsys.readouterr().out
    assert "steps on the flat" in printed
    assert "at most 3 1/s" in printed
    report = json.loads((tmp_path / "found.json").read_text())
    found = report["demands"]["step-rate"]
    assert not report["met"]
    assert found["cases"]["0°"]["figure"] > 3.0  # the shipped policy steps four times a second


def test_demands_that_are_met_end_with_0(exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gait = Gait(0.0, 0.2, math.radians(30.0), 0.0)
    good = Trial(False, 20.0, 9.0, 0.5, 9.0, 0.0, 2.5, 0.0, 0.5, 0.0, gait)
    monkeypatch.setattr("humoslope.evaluation.margins.trials.run_job", lambda job: good)
    out, demands = tmp_path / "found", ("double-support", "step-rate", "knee-flexion", "speed")
    assert main(["accept", str(exported), *QUICK, "--out", str(out), "--demands", *demands]) == 0
    assert json.loads((tmp_path / "found.json").read_text())["met"]


def test_mistakes_are_said_in_one_sentence(mistake: Callable[..., str], exported: Path, tmp_path: Path) -> None:
    assert "--trials 0 must be at least 1" in mistake("accept", str(exported), "--trials", "0")
    assert "--seconds 4 must be above 5, when the first push comes" in mistake(
        "accept", str(exported), "--seconds", "4"
    )
    assert "'no.xml' does not exist" in mistake("accept", str(exported), "--model", "no.xml")
    assert "holds no policy.json" in mistake("accept", str(tmp_path))
