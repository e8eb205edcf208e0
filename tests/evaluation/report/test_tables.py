"""Tables have our figures and the paper's in rows of their own, and say what is partial and what helped."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from humoslope.errors import UserError
from humoslope.evaluation.report.paper import FILE, Paper, read_paper
from humoslope.evaluation.report.results import Result, Training, read_methods, read_results
from humoslope.evaluation.report.seed_tables import main_over_seeds
from humoslope.evaluation.report.table import Column, Row, Sheet
from humoslope.evaluation.report.tables import ablation_table, cells_table, diagnostics_table, main_table
from humoslope.evaluation.track.protocol import HeldOutProtocol
from humoslope.provenance import plain
from humoslope.statistics import Average, average, proportion
from tests.evaluation.made_up import GRADES, report, sweep, write

STAGE2, URL = "HumoSlope-Stage2-Unitree-G1", "URL-TerrainRelative-Unitree-G1"


@pytest.fixture(scope="module")
def paper() -> Paper:
    return read_paper()


@pytest.fixture(scope="module")
def newer(tmp_path_factory) -> list[Result]:
    folder = tmp_path_factory.mktemp("results")
    write(folder, "a", report(0.9, STAGE2))
    write(folder, "b", sweep(33.0, STAGE2))
    write(folder, "c", report(0.2, URL, finished=40))
    return read_results([str(folder)])


@pytest.fixture(scope="module")
def results(newer) -> list[Result]:
    """Results from before contact of the robot with itself was measured, as the shipped ones are."""
    return [without_self_contact(result) for result in newer]


def without_self_contact(result: Result) -> Result:
    """The result as it was before the metric existed."""

    def older(of):
        return replace(of, summary={name: figure for name, figure in of.summary.items() if name != "self_contact"})

    return replace(result, cells=tuple(map(older, result.cells)), grades=tuple(map(older, result.grades)))


def titles(sheet: Sheet) -> list[str]:
    return [row.title for row in sheet.rows]


# The paper's numbers


def test_the_papers_tables_are_transcribed_whole(paper):
    assert [row.name for row in paper.main] == ["URL", "FastTD3", "Gallant", "Ours"]
    assert [row.max_grade for row in paper.main] == [25, 35, 31, 36]
    assert all(set(row.grades) == {0.0, 10.0, 20.0, 30.0} for row in paper.main)
    # What its text says of them.
    at_thirty = {row.name: row.grades[30.0] for row in paper.main}
    assert at_thirty["Ours"] == {"sr": 77.1, "mxd": 27.54, "t_trav": 62.8}
    assert {at_thirty[name]["sr"] for name in ("URL", "FastTD3", "Gallant")} == {0.0}
    for grade in (0.0, 10.0, 20.0):
        times = {row.name: row.grades[grade]["t_trav"] for row in paper.main}
        assert min(times, key=times.__getitem__) == "Ours"
    assert len(paper.ablation) == 6
    figures = {row.name: row.grades[20.0] for row in paper.ablation}
    assert figures["Stage I only"]["sr"] == 100.0
    assert min(figures, key=lambda name: figures[name]["com_height"]) == "Stage I only"
    assert max(figures, key=lambda name: figures[name]["knee_peak"]) == "w/o BSGA"
    assert figures["w/o BSGA"]["t_trav"] is None


def test_every_task_the_paper_is_compared_with_exists(paper):
    from humoslope.registry import all_tasks

    named = {task for row in (*paper.main, *paper.ablation) for task in row.tasks}
    assert named <= set(all_tasks())


def test_without_the_papers_file_there_are_only_our_rows_and_a_broken_one_is_a_mistake(results, tmp_path):
    sheet = main_table(results, read_paper(tmp_path / "nothing.json"))
    assert not any(row.source == "paper" for row in sheet.rows)
    broken = tmp_path / "paper.json"
    broken.write_text(FILE.read_text().replace('"max_grade"', '"max"'))
    with pytest.raises(UserError, match="cannot be read: 'max_grade'"):
        read_paper(broken)


# Rows


def test_the_papers_row_stands_below_ours_and_the_others_at_the_end(results, paper):
    assert titles(main_table(results, paper)) == [
        "at the commanded speed",
        STAGE2,
        "paper: Ours",
        f"{URL} (partial: 40 of 96 trials)",
        "paper: URL",
        "paper: FastTD3",
        "paper: Gallant",
    ]


def test_a_name_given_by_hand_decides_what_it_is_compared_with(results, paper):
    sheet = main_table([replace(results[0], name="Gallant"), replace(results[1], name="mine")], paper)
    assert titles(sheet)[1:4] == ["Gallant", "paper: Gallant", "mine (partial: 40 of 96 trials)"]


def test_table_1_has_its_columns_and_our_figures_in_them(results, paper):
    sheet = main_table(results, paper)
    titles = [column.title for column in sheet.columns]
    assert titles[:3] == ["0° SR %", "0° MXD m", "0° T_trav s"]
    assert titles[9:] == ["30° SR %", "30° MXD m", "30° T_trav s", "max grade °"]
    steep = results[0].at(30.0).summary
    assert sheet.rows[1].values[9:] == (steep["success"], steep["max_distance"], steep["traversal_s"], 33.0)
    assert sheet.rows[2].values[9:] == (77.1, 27.54, 62.8, 36)


def test_table_1_begins_with_the_time_that_the_commanded_speed_takes(results, paper):
    sheet = main_table(results, paper)
    row = sheet.rows[0]
    assert (row.title, row.source) == ("at the commanded speed", "reference")
    assert row.note == "0.5 m/s along the ground to 31.5 m"
    # 18 of the 31 m between start and goal are slopes.
    expected = [(13.0 + 18.0 / math.cos(math.radians(grade))) / 0.5 for grade in GRADES]
    assert [row.values[i] for i in (2, 5, 8, 11)] == pytest.approx(expected)
    assert {row.values[i] for i in (0, 1, 3, 4, 6, 7, 9, 10, 12)} == {None}
    said = "0.5 m/s along the ground take " + ", ".join(
        f"{t:.1f} s at {g:g}°" for t, g in zip(expected, GRADES, strict=True)
    )
    assert any(said in note and "MXD stops at 31.5 m" in note for note in sheet.notes)
    assert any(f"take {expected[2]:.1f} s at 20°. " in note for note in ablation_table(results, paper).notes)


def test_results_of_other_speeds_have_times_of_their_own(results, paper):
    fast = replace(results[1], setup=replace(results[1].setup, speed=0.8))
    rows = main_table([results[0], fast], paper).rows
    assert [row.note for row in rows if row.source == "reference"] == [
        "0.5 m/s along the ground to 31.5 m",
        "0.8 m/s along the ground to 31.5 m",
    ]
    assert rows[1].values[2] == pytest.approx(31.0 / 0.8)
    assert not any(row.source == "reference" for row in main_table([replace(results[0], setup=None)], paper).rows)


def test_table_2_has_the_papers_figures_only_at_its_grade(results, paper):
    sheet = ablation_table(results, paper)
    there = results[0].at(20.0).summary
    shown = sheet.rows[0].values
    assert shown[:3] == (there["success"], there["max_distance"], there["traversal_s"])
    assert shown[3:7] == (
        there["cost_of_transport"],
        there["yaw_rate_variance"],
        there["com_height"],
        there["knee_peak"],
    )
    assert sheet.rows[1].title == "paper: Full"
    assert sheet.rows[1].values == (98.2, 31.75, 53.7, 1.380, 0.1008, 0.669, 117.9, None, None, None)
    assert [row.source == "paper" for row in ablation_table(results, paper, 30.0).rows] == [False, False]
    nowhere = ablation_table(results, paper, 15.0).rows[0].values
    assert set(nowhere) == {None}


def test_diagnostics_are_told_uphill_on_the_flat_and_downhill(results):
    sheet = diagnostics_table(results)
    assert [row.values[0] for row in sheet.rows[:3]] == ["up", "flat", "down"]
    assert [row.values[1] for row in sheet.rows[:3]] == pytest.approx([17.19, 5.73, -5.73], abs=0.01)
    assert sheet.rows[0].values[6:9] == pytest.approx((20 / 65, 30 / 65, 15 / 65))
    assert sheet.rows[0].values[9:12] == pytest.approx((15 / 65, 30 / 65, 20 / 65))
    assert diagnostics_table(results, 15.0).rows[0].values == ("up", *[None] * 11)


def test_every_figure_is_told_by_grade_and_friction(results):
    sheet = cells_table(results)
    assert len(sheet.rows) == 2 * len(results[0].cells)
    row, cell = sheet.rows[4], results[0].cells[4]
    shown = dict(zip((column.title for column in sheet.columns), row.values, strict=True))
    assert (shown["grade °"], shown["friction"]) == (10.0, pytest.approx(0.776, abs=1e-3))
    assert (shown["SR %"], shown["MXD m"]) == (cell.summary["success"], cell.summary["max_distance"])
    assert (shown["CoT +"], shown["τ max Nm"]) == (cell.summary["cost_of_transport_positive"], cell.summary["knee_max"])
    assert shown["fell"] + shown["left"] + shown["timed out"] + cell.summary["success"].count == 8


def test_only_grades_that_were_walked_have_columns_and_without_any_the_papers(results, paper):
    few = replace(results[0], grades=results[0].grades[2:3])
    assert [column.group for column in main_table([few], paper).columns] == ["20°"] * 3 + [""]
    none = replace(results[0], grades=())
    assert len(main_table([none], paper).columns) == 13


@pytest.mark.parametrize(
    ("training", "said"),
    [
        ([Training((37_900_000,), 0.0)], "37.9 M steps, harness"),
        ([Training((37_900_000, 23_000_000), 0.0)], "37.9 + 23 M steps, harness"),
        ([Training((60_000_000,), None)], "60 M steps, no harness"),
        ([Training((60_000_000,), 0.2)], "60 M steps, harness, 20% left"),
        (
            [Training((61_000_000,), 0.0), Training((60_000_000,), 0.0), Training((59_000_000,), 0.0)],
            "59 to 61 M steps, 3 checkpoints, harness",
        ),
    ],
)
def test_every_row_says_what_its_training_cost_and_whether_a_harness_helped(results, paper, training, said):
    result = replace(results[0], training=tuple(training))
    assert main_table([result], paper).rows[1].note == said
    assert ablation_table([result], paper).rows[0].note == said
    assert diagnostics_table([result]).rows[0].note == said


def test_a_row_says_in_what_it_departs_from_the_protocol(tmp_path, paper):
    def asked(**changes):
        return {
            "protocol": plain(replace(HeldOutProtocol(), **changes)),
            "checkpoints": [{**checkpoint, "sha256": "a"}],
        }

    checkpoint = report()["checkpoints"][0]
    track = write(tmp_path, "track", report(0.9, STAGE2, **asked(noise=False, timestep=0.002, grades=(20.0,))))
    limit = write(tmp_path, "sweep", sweep(33.0, STAGE2, **asked(noise=False, speed=0.4, tiers=(0.6,))))
    trained = "40 M steps, harness"
    (alone,) = read_results([str(track)])
    said = f"{trained}; departs from the protocol: noise False, timestep 0.002"
    for sheet in (main_table([alone], paper), ablation_table([alone], paper), cells_table([alone])):
        assert said in [row.note for row in sheet.rows]
    (joined,) = read_results([str(track), str(limit)])
    said = f"{said}, in the sweep speed 0.4, noise False"
    assert main_table([joined], paper).rows[1].note == said
    assert f"| {said} |" in main_table([joined], paper).to_markdown()
    assert main_over_seeds(read_methods([str(track), str(limit)]), paper).rows[0].note == f"1 seed, {said}"
    (plain_one,) = read_results([str(write(tmp_path, "plain", report(0.9, STAGE2, **asked(trials=4))))])
    assert main_table([plain_one], paper).rows[1].note == trained


def test_a_partial_table_says_so(results, paper):
    for sheet in (main_table(results, paper), ablation_table(results, paper), diagnostics_table(results)):
        assert any("trials are missing" in note for note in sheet.notes)
    assert not any("trials are missing" in note for note in main_table(results[:1], paper).notes)


def test_a_sweep_that_ended_too_soon_is_said(results, paper):
    sheet = main_table([replace(results[0], beyond=True)], paper)
    assert f"{STAGE2}: the sweep ends there, the limit may be higher." in sheet.notes


# On the screen and in files

SHEET = Sheet(
    title="Both",
    columns=(Column("SR", "%", 1, "0°", interval=True), Column("MXD", "m", 2, "0°", interval=True), Column("on")),
    rows=(
        Row("mine", "3 M steps", (proportion(3, 4), average(np.array([12.25, 12.75])), "up"), partial="4 of 8 trials"),
        Row("mine", "3 M steps", (None, None, "down"), more=True),
        Row("theirs", "", (50.0, 31.5, None), source="paper"),
    ),
    notes=("SR: share.",),
)


def screen(sheet: Sheet) -> str:
    console = Console(width=200)
    with console.capture() as capture:
        console.print(sheet.to_rich())
    return "\n".join(line.rstrip() for line in capture.get().splitlines())


def test_the_screen_shows_every_figure_and_interval_and_each_name_once():
    said = screen(SHEET)
    assert said.count("mine") == 1
    for part in (
        "75.0",
        "30-95",
        "12.50",
        "±3.177",
        "partial: 4 of 8 trials",
        "3 M steps",
        "paper: theirs",
        "50.0",
        "SR: share.",
    ):
        assert part in said
    assert said.count("0°") == 1


def shown(sheet: Sheet, width: int, terminal: bool = True) -> list[str]:
    out = io.StringIO()
    sheet.show(Console(file=out, width=width, force_terminal=terminal, no_color=True))
    return [re.sub(r"\x1b\[[\d;]*m", "", line).rstrip() for line in out.getvalue().splitlines()]


def test_a_narrow_terminal_gets_several_tables_that_fit_with_every_figure(results, paper):
    for sheet in (SHEET, main_table(results, paper)):
        for width in (139, 80, 50):
            lines = shown(sheet, width)
            assert max(map(len, lines)) <= width
            assert sum(line.strip().startswith("method") for line in lines) == len(sheet.parts(width))
            said = "\n".join(lines)
            for column, value in ((c, v) for row in sheet.rows for c, v in zip(sheet.columns, row.values, strict=True)):
                if isinstance(value, Average):
                    assert f"{value.mean:.{column.digits}f}" in said
            assert lines[0].startswith(sheet.title[:20])
    assert [len(part.columns) for part in SHEET.parts(40)] == [1, 2]
    assert [len(part.columns) for part in SHEET.parts(1)] == [1, 1, 1]  # one column is always shown
    assert len(SHEET.parts(1000)) == 1


def test_where_there_is_no_terminal_a_table_is_whole(results, paper):
    sheet = main_table(results, paper)
    assert sum("method" in line for line in shown(sheet, 80, terminal=False)) == 1


def test_markdown_has_a_row_for_each_and_the_papers_in_italics():
    lines = SHEET.to_markdown().splitlines()
    assert lines[2] == "| method | training | 0° SR % | 0° MXD m | on |"
    assert lines[4] == "| mine (partial: 4 of 8 trials) | 3 M steps | 75.0 (30-95) | 12.50 (±3.177) | up |"
    assert lines[5] == "| mine | 3 M steps | - | - | down |"
    assert lines[6] == "| *paper: theirs* |  | *50.0* | *31.50* | *-* |"
    assert lines[8] == "SR: share."


def test_csv_and_json_have_full_precision_and_say_whose_a_row_is():
    rows = list(csv.DictReader(io.StringIO(SHEET.to_csv())))
    assert [row["source"] for row in rows] == ["ours", "ours", "paper"]
    assert (rows[0]["0° SR %"], rows[0]["0° MXD m"], rows[0]["partial"]) == ("75.0", "12.5", "4 of 8 trials")
    assert float(rows[0]["0° SR % low"]) == pytest.approx(30.06, abs=0.01)
    assert (rows[2]["0° SR %"], rows[2]["0° SR % low"]) == ("50.0", "")
    assert (rows[2]["0° MXD m"], rows[2]["0° MXD m high"]) == ("31.5", "")
    assert float(rows[0]["0° MXD m high"]) == pytest.approx(12.5 + 3.177, abs=1e-3)
    told = json.loads(SHEET.to_json())
    assert told["rows"][0]["0° SR % high"] == pytest.approx(95.44, abs=0.01)
    assert told["rows"][1]["0° SR %"] is None
    assert told["notes"] == ["SR: share."]


def test_every_table_can_be_written_in_every_form(results, paper):
    for sheet in (main_table(results, paper), ablation_table(results, paper), cells_table(results)):
        rows = list(csv.DictReader(io.StringIO(sheet.to_csv())))
        assert len(rows) == len(sheet.rows) == len(json.loads(sheet.to_json())["rows"])
        assert len(sheet.to_markdown().splitlines()) == 4 + len(sheet.rows) + 1 + len(sheet.notes)
        assert STAGE2 in screen(sheet)


def test_a_column_of_self_contact_is_there_if_a_result_has_it_and_older_results_have_none_in_it(newer, results, paper):
    for build in (main_table, ablation_table, lambda results, paper: cells_table(results)):
        assert not any(column.label == "self-contact" for column in build(results, paper).columns)
        sheet = build([newer[0], results[1]], paper)
        places = [i for i, column in enumerate(sheet.columns) if column.label == "self-contact"]
        assert places
        name = newer[0].name
        for row in sheet.rows:
            assert len(row.values) == len(sheet.columns)
            known = row.source == "ours" and row.name == name
            assert all((row.values[i] is not None) == known for i in places)
