"""`humoslope table` and `humoslope figures` put the results of evaluations together."""

from __future__ import annotations

import csv

import pytest

from humoslope.cli import main
from tests.evaluation.made_up import report, sweep, write


@pytest.fixture
def folder(tmp_path):
    """Results of one method, with its sweep."""
    folder = tmp_path / "results"
    folder.mkdir()
    write(folder, "a", report(0.9, "HumoSlope-Stage2-Unitree-G1"))
    write(folder, "b", sweep(33.0, "HumoSlope-Stage2-Unitree-G1"))
    return folder


@pytest.mark.parametrize(
    ("which", "shown"),
    [
        ("1", "paper: Ours"),
        ("2", "paper: Full"),
        ("diagnostics", "torso pitch"),
        ("causes", "Why trials failed"),
    ],
)
def test_a_table_is_printed_and_written(folder, tmp_path, capsys, which, shown):
    out = tmp_path / "tables" / "v1.0"
    assert main(["table", which, str(folder), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert shown in said
    assert "40 M steps, harness" in said
    assert {path.name for path in out.parent.iterdir()} == {"v1.0.md", "v1.0.csv", "v1.0.json"}
    assert all(f"wrote {path}" in said for path in out.parent.iterdir())


def test_a_method_can_be_given_the_name_of_a_row_of_the_paper(folder, capsys):
    assert main(["table", "1", f"Gallant={folder / 'a.json'}"]) == 0
    lines = [line.split("  ")[0].strip() for line in capsys.readouterr().out.splitlines()]
    assert lines.index("paper: Gallant") == lines.index("Gallant") + 2  # below the line on its training


def test_an_evaluation_leaves_tables_and_what_they_can_be_made_of_again(untrained, tmp_path, capsys):
    out = tmp_path / "look"
    few = ["--grades", "0", "20", "--tiers", "0.6", "--trials", "1", "--parallel-trials", "1", "--timeout-s", "1.4"]
    assert main(["evaluate", str(untrained), *few, "--out", str(out)]) == 0
    assert "paper: Ours" in capsys.readouterr().out
    cells = list(csv.DictReader((tmp_path / "look.csv").read_text().splitlines()))
    assert [(cell["grade °"], cell["SR %"], cell["source"]) for cell in cells] == [
        ("0.0", "0.0", "ours"),
        ("20.0", "0.0", "ours"),
    ]
    told = (tmp_path / "look.md").read_text()
    for title in (
        "Held-out slope tracks",
        "paper: Stage I only",
        "Posture and load by direction",
        "grade and friction",
    ):
        assert title in told
    assert main(["table", "1", f"{out}.json", "--out", str(tmp_path / "again")]) == 0
    assert (tmp_path / "again.md").read_text() in told


def test_figures_are_drawn(folder, tmp_path, capsys):
    assert main(["figures", str(folder), "--out", str(tmp_path / "figures")]) == 0
    assert capsys.readouterr().out.count("wrote ") == 4
    assert len(list((tmp_path / "figures").glob("*.png"))) == 4


@pytest.mark.parametrize("verb", [["table", "1"], ["figures"]])
def test_mistakes_are_said_in_one_sentence(mistake, tmp_path, monkeypatch, verb):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    assert "does not exist" in mistake(*verb, "nothing.json")
    assert "there are no results in empty" in mistake(*verb, "empty")
    good = str(write(tmp_path, "good", report()))
    assert "is no folder one can write to" in mistake(*verb, good, "--out", "file/out")
