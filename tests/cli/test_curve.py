"""`humoslope curve` draws a run's event files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from torch.utils.tensorboard import SummaryWriter

from humoslope.cli import main
from humoslope.evaluation.report.curve import PANELS, STEPS, read_table


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    """A run of 50 iterations."""
    writer = SummaryWriter(tmp_path)
    for i in range(50):
        writer.add_scalar(STEPS, 12288.0 * (i + 1), i)
        for panel in PANELS:
            writer.add_scalar(panel.tag, i / 50.0, i)
    writer.close()
    return tmp_path


def test_the_picture_lands_in_the_run_folder(run_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["curve", str(run_dir)]) == 0
    assert (run_dir / "curve.png").read_bytes().startswith(b"\x89PNG")
    assert str(run_dir / "curve.png") in capsys.readouterr().out


def test_the_picture_lands_where_it_is_wanted(run_dir: Path, tmp_path: Path) -> None:
    assert main(["curve", str(run_dir), "--out", str(tmp_path / "pictures" / "first")]) == 0
    assert (tmp_path / "pictures" / "first.png").is_file()


def test_mistakes_are_said_in_one_sentence(mistake: Callable[..., str], run_dir: Path, tmp_path: Path) -> None:
    assert "does not exist" in mistake("curve", str(tmp_path / "nowhere"))
    (tmp_path / "empty").mkdir()
    assert "holds no curves" in mistake("curve", str(tmp_path / "empty"))
    assert "cannot write the figure" in mistake("curve", str(run_dir), "--out", str(tmp_path / "a.docx"))


def test_a_run_goes_on_from_the_table_that_is_kept_of_it(run_dir: Path, tmp_path: Path) -> None:
    table, later = tmp_path / "kept.csv", tmp_path / "later"
    assert main(["curve", str(run_dir), "--table", str(table)]) == 0
    writer = SummaryWriter(later)  # resumed from iteration 40 on another machine
    for i in range(40, 60):
        writer.add_scalar(STEPS, 12288.0 * (i + 1), i)
        writer.add_scalar("Train/reward", 7.0, i)
    writer.close()
    assert main(["curve", str(later), "--table", str(table)]) == 0
    kept = read_table(table)
    assert kept[STEPS] == {i: 12288.0 * (i + 1) for i in range(60)}
    assert kept["Train/reward"] == {i: 7.0 if i >= 40 else i / 50.0 for i in range(60)}
    assert list(kept["Train/episode_length"]) == list(range(40))


def test_a_foreign_table_is_refused(mistake: Callable[..., str], run_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y\n1,2\n")
    assert "is not a table of curves" in mistake("curve", str(run_dir), "--table", str(tmp_path / "a.csv"))
