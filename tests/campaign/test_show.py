"""What a campaign shows: every row with its state, and what is left in steps, time and disk."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console, RenderableType

from humoslope.campaign.run import Run, run
from humoslope.campaign.show import Board, dry_run, in_words
from tests.campaign.campaigns import Humoslope, plan


def text(table: RenderableType) -> str:
    console = Console(width=160, file=io.StringIO())
    with console.capture() as capture:
        console.print(table)
    return capture.get()


def cells(said: str, row: str) -> list[str]:
    return next(line.split() for line in said.splitlines() if line.split()[:1] == [row])


def test_a_dry_run_counts_what_is_left(tmp_path: Path) -> None:
    state = Run(plan(tmp_path))
    said = text(dry_run(state, 0.0, 1))
    assert "No speed is known yet: name one with --speed" in said
    assert cells(said, "stage1") == ["stage1", "2", "0", "10", "0.00", "-", "0.02"]
    said = text(dry_run(state, 0.01, 2))
    assert cells(said, "full")[5] == f"{2 * 704 / 0.01 / 3600:.2f}"
    assert cells(said, "track")[1:3] == ["4", "0"]
    assert "At 0 steps/s" in said
    assert "2 at once." in said
    assert not (tmp_path / "out").exists()


def test_a_board_shows_the_state_of_every_row(tmp_path: Path) -> None:
    humoslope, state = Humoslope(), Run(plan(tmp_path))
    humoslope.fails = {"full/seed2"}
    out = io.StringIO()
    with Board(state, Console(file=out, width=160), at_once=1) as board:
        assert "12 left" in text(board.table())
        run(state, 1, 1, board.show, humoslope)
    said = out.getvalue()
    assert "begins: stage1/seed1 training" in said
    assert "failed: full/seed2 training: exit code 2: it cannot walk." in said
    assert "10 done, 1 failed, 1 barred by a failure" in said
    lines = [line.split() for line in text(board.table()).splitlines()]
    assert ["full", "1", "11/11", "0.00", "2,000", "done", "-", "done", "-"] in lines
    assert ["2", "0/11", "0.00", "-", "failed", "-", "barred", "-"] in lines


@pytest.mark.parametrize(("seconds", "said"), [(0, "0:00 h"), (3660, "1:01 h"), (90000, "1 day, 1:00 h")])
def test_times_are_told_in_hours_and_minutes(seconds: float, said: str) -> None:
    assert in_words(seconds) == said
