"""`humoslope dashboard`: a run in the terminal, from what it has written so far."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from torch.utils.tensorboard import SummaryWriter

from humoslope.cli import main
from humoslope.errors import UserError
from humoslope.evaluation.report.chart import EIGHTHS, chart, thinned
from humoslope.evaluation.report.curve import STEPS
from humoslope.evaluation.report.dashboard import CurveFollower, find_newest, progress_of, view

PER_ITERATION = 12288.0


def write(writer: SummaryWriter, iterations: range) -> None:
    for i in iterations:
        writer.add_scalar(STEPS, PER_ITERATION * (i + 1), i)
        writer.add_scalar("Perf/steps_per_second", 2.0 * PER_ITERATION, i)
        writer.add_scalar("Train/reward", 0.1 * i, i)
        writer.add_scalar("Train/falls_per_second", 1.0 / (1 + i), i)
        writer.add_scalar("Curriculum/harness", max(0.0, 1.0 - 0.05 * i), i)
    writer.flush()


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    """A run of 30 of 50 iterations, two a second."""
    folder = tmp_path / "logs" / "Task" / "run"
    start = folder / "starts" / "1"
    start.mkdir(parents=True)
    (start / "config.json").write_text(json.dumps({"task": "Task", "agent": {"max_iterations": 50}}))
    writer = SummaryWriter(str(folder))
    write(writer, range(30))
    writer.close()
    (folder / "model_20.pt").touch()
    return folder


def shown(run_dir: Path, width: int = 120) -> str:
    console = Console(width=width, file=io.StringIO(), color_system=None)
    console.print(view(run_dir, CurveFollower(run_dir).read(), width))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


# Charts


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=300), st.integers(1, 60), st.integers(1, 6))
def test_a_chart_has_a_bar_for_each_part_and_the_highest_value_fills_it(
    values: list[float], width: int, height: int
) -> None:
    lines = chart(values, width, height)
    assert len(lines) == height
    assert {len(line) for line in lines} == {min(width, len(values))}
    assert set("".join(lines)) <= set(EIGHTHS)
    eighths = np.array([[EIGHTHS.index(c) for c in line] for line in lines]).sum(axis=0)
    assert (eighths >= 1).all()
    means = thinned(np.array(values), width)
    assert (np.diff(eighths)[np.diff(means) > 0.0] >= 0).all()
    if means.max() - means.min() > 1e-3:
        assert eighths[means.argmax()] == 8 * height
        assert eighths[means.argmin()] == 1


def test_a_chart_with_known_ends_shows_values_between_them() -> None:
    assert chart([0.0, 1.0], 2, 1, 0.0, 2.0) == ["▁▅"]
    assert chart([], 5, 2) == ["", ""]
    assert chart([float("nan"), 1.0], 5, 1) == ["▁"]


# The run


def test_progress_and_every_curve_are_shown(run_dir: Path) -> None:
    text = shown(run_dir)
    assert "Task" in text
    assert "30/50" in text
    assert "0.37 M steps" in text
    assert "24,576/s" in text
    assert "left 0:00:10" in text
    assert "model_20.pt" in text
    assert "reward per second: 2.9" in text
    assert "0 to 2.9" in text
    assert "harness: 0" in text
    assert "terrain level" not in text
    assert max(map(len, text.splitlines())) <= 120
    assert max(map(len, shown(run_dir, width=60).splitlines())) <= 60


def test_a_growing_run_is_followed_and_a_resumed_one_goes_on_in_the_same_curve(run_dir: Path) -> None:
    follower = CurveFollower(run_dir)
    assert max(follower.read()[STEPS]) == 29
    writer = SummaryWriter(str(run_dir), filename_suffix=".resumed")
    writer.add_scalar(STEPS, PER_ITERATION * 26, 25)
    writer.flush()
    later = follower.read()
    assert max(later[STEPS]) == 25
    write(writer, range(26, 50))
    now = follower.read()
    assert list(now[STEPS]) == list(range(50))
    done = progress_of(run_dir, now)
    assert (done.iteration, done.last, done.left_s) == (50, 50, 0.0)
    assert "complete" in shown(run_dir)
    writer.close()


def test_the_newest_run_is_shown_once_where_there_is_no_terminal(
    run_dir: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    older = run_dir.with_name("older")
    writer = SummaryWriter(str(older))
    write(writer, range(2))
    writer.close()
    for path in older.iterdir():
        os.utime(path, (1.0, 1.0))
    monkeypatch.chdir(run_dir.parents[2])
    assert find_newest() == Path("logs/Task/run")
    assert main(["dashboard"]) == 0
    assert "30/50" in capsys.readouterr().out
    assert main(["dashboard", str(older), "--once"]) == 0
    assert "2 iterations" in capsys.readouterr().out  # the folder does not say of how many


def test_mistakes_are_said_in_one_sentence(
    mistake: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty").mkdir()
    assert "holds no curves yet" in mistake("dashboard", str(tmp_path / "empty"))
    assert "does not exist" in mistake("dashboard", str(tmp_path / "nowhere"))
    assert "every is 0; it must be positive" in mistake("dashboard", str(tmp_path / "empty"), "--every", "0")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match="no run with curves under 'logs'"):
        find_newest()
