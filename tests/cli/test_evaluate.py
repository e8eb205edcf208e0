"""`humoslope evaluate`: table and files, several checkpoints, the sweep, interruptions, and mistakes."""

from __future__ import annotations

import csv
import json
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from humoslope.cli import main
from humoslope.evaluation.causes import CAUSES
from humoslope.evaluation.track.progress import Progress
from humoslope.evaluation.track.protocol import SWEEP_GRADES
from humoslope.evaluation.track.run import Plan
from humoslope.learning import checkpoint

TINY = ("--grades", "0", "30", "--tiers", "0.6", "--trials", "2", "--parallel-trials", "1", "--timeout-s", "1.2")


def told(out: Path) -> dict[str, Any]:
    return json.loads(out.with_name(out.name + ".json").read_text())


@pytest.fixture
def path(untrained: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(untrained, tmp_path))


@pytest.fixture
def evaluate(path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[dict[str, Any], str]]:
    """evaluate("--seed", "1"): what was written for the checkpoint under the tiny protocol, and what was printed."""

    def run(*options: str, code: int = 0) -> tuple[dict[str, Any], str]:
        assert main(["evaluate", str(path), *TINY, *options]) == code
        return told(path.with_name("model_0.heldout")), capsys.readouterr().out

    return run


def figures(report: dict[str, Any]) -> dict[str, Any]:
    return {name: report[name] for name in ("grades", "cells", "trials", "finished")}


def test_the_table_has_a_row_for_every_cell_and_the_file_says_what_was_measured(
    evaluate: Callable[..., tuple[dict[str, Any], str]],
) -> None:
    report, printed = evaluate()
    rows = [line.split() for line in printed.splitlines() if "2/2" in line]
    assert [row[:2] for row in rows] == [["0", "0.60"], ["30", "1.18"]]
    for row, cell in zip(rows, report["cells"], strict=True):
        summary = cell["summary"]
        assert row[3:6] == ["0.0", "0.0-65.8", f"{summary['max_distance']['mean']:.2f}"]
        ends = [summary[end] for end in ("fell", "left", "timed_out")]
        assert row[7:] == [str(count) for count in ends]
        assert sum(ends) == 2
    assert (report["what"], report["trials"], report["finished"], report["partial"]) == ("held-out", 4, 4, False)
    assert report["protocol"]["timeout_s"] == 1.2
    assert report["physics"]["cone"] == "elliptic"
    assert report["checkpoints"][0]["task"] == "HumoSlope-Stage1-Unitree-G1"
    for grade in report["grades"]:
        assert sum(grade["causes"].values()) == 2
        assert set(grade["causes"]) <= set(CAUSES)
    assert "Why trials failed: the first cause, by grade" in printed
    assert "departs from the protocol: timeout_s 1.2" in printed
    assert "Its training used the harness" in printed
    assert report["command_line"].startswith("humoslope evaluate ")


def test_what_was_walked_is_not_walked_again_unless_asked_for(
    evaluate: Callable[..., tuple[dict[str, Any], str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    first, printed = evaluate()
    assert "continues with" not in printed
    monkeypatch.setattr("humoslope.evaluation.track.run.git_state", lambda: "commit of tomorrow\n")
    more, printed = evaluate("--trials", "3")
    monkeypatch.undo()
    assert "continues with 4 trials" in printed
    assert more["finished"] == 6
    assert more["code"] == f"{first['code']}, commit of tomorrow"
    anew, printed = evaluate("--fresh")
    assert "continues with" not in printed
    assert figures(anew) == figures(first)
    monkeypatch.setattr(Progress, "step", lambda self, envs: pytest.fail("walked again"))
    again, printed = evaluate()
    assert figures(again) == figures(first)
    assert again["wall_clock_s"] >= anew["wall_clock_s"] > 0.0  # what was walked before has taken its time
    monkeypatch.undo()
    _, printed = evaluate("--seed", "1")
    assert "continues with" not in printed


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_evaluation_says_that_it_is_partial_and_goes_on_to_the_same_figures(
    evaluate: Callable[..., tuple[dict[str, Any], str]], monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    whole, _ = evaluate("--fresh")
    steps = []

    def interrupt(self: Progress, envs: int) -> None:
        steps.append(envs)
        if len(steps) == 70:
            signal.raise_signal(number)

    handlers = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    monkeypatch.setattr(Progress, "step", interrupt)
    part, printed = evaluate("--fresh", code=128 + number)
    monkeypatch.undo()
    assert len(steps) == 70
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == handlers
    assert part["partial"]
    assert 0 < part["finished"] < 4
    assert f"Partial: {part['finished']} of 4 trials" in printed
    rest, printed = evaluate()
    assert f"continues with {part['finished']} trials" in printed
    assert figures(rest) == figures(whole)


def test_an_evaluation_that_is_stopped_at_once_leaves_a_partial_result_of_nothing(
    evaluate: Callable[..., tuple[dict[str, Any], str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Progress, "step", lambda self, envs: signal.raise_signal(signal.SIGINT))
    report, printed = evaluate(code=130)
    assert (report["partial"], report["finished"], report["cells"]) == (True, 0, [])
    assert "Partial: 0 of 4 trials" in printed


def test_checkpoints_of_one_method_are_pooled(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    checkpoint.save(path.with_name("model_5.pt"), checkpoint.load(path) | {"iteration": 5})
    out = path.with_name("both")
    assert main(["evaluate", str(path), str(path.with_name("model_5.pt")), *TINY, "--out", str(out)]) == 0
    report = told(out)
    assert report["trials"] == 8
    assert [checkpoint["iteration"] for checkpoint in report["checkpoints"]] == [0, 5]
    assert all(cell["summary"]["success"]["total"] == 4 for cell in report["cells"])
    assert "4/4" in capsys.readouterr().out
    assert len(list(path.parent.glob("both.*.npz"))) == 2


def test_a_sweep_says_how_steep_a_track_is_mastered(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    grades = ("--grades", "12", "13", "--trials", "1", "--parallel-trials", "1", "--timeout-s", "0.5")
    assert main(["evaluate", str(path), "--sweep", *grades]) == 0
    report = told(path.with_name("model_0.sweep"))
    assert report["what"] == "sweep"
    assert report["slope_limit"] == {"grade": None, "any_success": None, "beyond": False}
    assert report["protocol"]["tiers"] == [0.6]
    assert "Max grade" in (printed := capsys.readouterr().out)
    assert "below 12°; steepest with any success: none" in printed
    rows = list(csv.DictReader(path.with_name("model_0.sweep.csv").read_text().splitlines()))
    assert [(row["grade °"], row["SR %"], row["timed out"]) for row in rows] == [
        ("12.0", "0.0", "1"),
        ("13.0", "0.0", "1"),
    ]


@pytest.mark.parametrize(
    ("options", "grades", "trials"),
    [
        ((), (0.0, 10.0, 20.0, 30.0), 128),
        (("--sweep",), SWEEP_GRADES, 32),
        (("--no-sweep",), (0.0, 10.0, 20.0, 30.0), 128),
        (("--sweep", "--trials", "8"), SWEEP_GRADES, 8),
        (("--sweep", "--no-sweep"), (0.0, 10.0, 20.0, 30.0), 128),
        (("--out", "--sweep=1"), None, None),
    ],
)
def test_the_defaults_of_the_protocol_follow_the_choice_of_a_sweep(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: tuple[str, ...],
    grades: tuple[float, ...] | None,
    trials: int | None,
) -> None:
    plans: list[Plan] = []
    monkeypatch.setattr("humoslope.cli.evaluate.subject", lambda path: path)
    monkeypatch.setattr("humoslope.cli.evaluate.evaluate", lambda found, plan, console: plans.append(plan) or 0)
    if grades is None:
        with pytest.raises(SystemExit) as stop:
            main(["evaluate", "model_0.pt", *options])
        assert stop.value.code == 2
        assert "--out" in capsys.readouterr().err
        return
    assert main(["evaluate", "model_0.pt", *options]) == 0
    assert (plans[0].protocol.grades, plans[0].protocol.trials) == (grades, trials)
    assert plans[0].sweep == (grades == SWEEP_GRADES)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--grades", "41"), "grade 41 must be between 0 and 40"),
        (("--parallel-trials", "0"), "parallel_trials is 0"),
        (("--trials", "0"), "trials is 0"),
        (("--timestep", "0.003"), "does not divide"),
        (("--start-place", "99"), "start_place is 99 m; it must lie before success_place, 31.5 m"),
        (("--start-place", "-1"), "start_place is -1"),
        (("--course", "held-out-trak"), "did you mean 'held-out-track'"),
        (("--out", f"{__file__}/out"), "is no folder one can write to"),
    ],
)
def test_an_impossible_option_is_said_in_one_sentence(
    mistake: Callable[..., str], untrained: Path, options: tuple[str, str], said: str
) -> None:
    assert said in mistake("evaluate", str(untrained), *options)


def test_what_is_no_checkpoint_is_said_in_one_sentence(mistake: Callable[..., str], tmp_path: Path) -> None:
    assert "needs a checkpoint" in mistake("evaluate")
    assert "does not exist" in mistake("evaluate", str(tmp_path / "missing.pt"))


def test_a_checkpoint_that_is_given_twice_is_refused(mistake: Callable[..., str], untrained: Path) -> None:
    assert "is given twice" in mistake("evaluate", str(untrained), str(untrained))


def test_checkpoints_of_different_tasks_are_not_pooled(
    mistake: Callable[..., str], untrained: Path, tmp_path: Path
) -> None:
    other = tmp_path / "model_1.pt"
    checkpoint.save(other, checkpoint.load(untrained) | {"task": "HumoSlope-Stage1-NoZMP-Unitree-G1"})
    said = mistake("evaluate", str(untrained), str(other), *TINY)
    assert "only trials of one method are pooled" in said
