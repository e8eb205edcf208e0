"""Tables over seeds show intervals of seeds, and call a method better only where these say so."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from humoslope.cli import main
from humoslope.errors import UserError
from humoslope.evaluation.report import seeds
from humoslope.evaluation.report.paper import read_paper
from humoslope.evaluation.report.results import Method, read_methods, read_results
from humoslope.evaluation.report.seed_tables import ONE_SEED_NOTE, ablation_over_seeds, differences, main_over_seeds
from humoslope.evaluation.report.seeds import Estimate
from humoslope.evaluation.report.tables import MEAN_NOTE, SR_NOTE, ablation_table, main_table
from humoslope.evaluation.track.summary import trial_values
from humoslope.statistics import Proportion
from tests.evaluation.made_up import GRADES, SEGMENTS, TIERS, outcomes, report, sweep, write

FULL, BARE = "HumoSlope-Stage2-Unitree-G1", "HumoSlope-Stage2-NoBSGA-Unitree-G1"


@pytest.fixture(scope="module", autouse=True)
def _few_draws():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(seeds, "DRAWS", 300)
        yield


def checkpoint(task: str, seed: int) -> dict[str, object]:
    return {
        "task": task,
        "total_steps": 20_000_000,
        "harness": 0.0,
        "iteration": 7,
        "ancestor": None,
        "sha256": f"{task} {seed}",
    }


def trained(skill: float, task: str, seed: int) -> dict[str, object]:
    """Result of a training of about that skill."""
    from humoslope.evaluation.report.results import to_report

    varied = skill + np.random.default_rng(seed).normal(scale=0.01)
    told = to_report(outcomes(varied, seed), grades=GRADES, tiers=TIERS, segments=SEGMENTS, speed=0.5, mass=33.0)
    return report(skill, task, checkpoints=[checkpoint(task, seed)], **told)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Three trainings of a skilled method, four of one with less skill, and one of a third; the first has sweeps."""
    folder = tmp_path_factory.mktemp("seeds")
    made = [write(folder, f"full{s}", trained(0.9, FULL, s)) for s in (1, 2, 3)]
    made += [write(folder, f"sweep{s}", sweep(30.0 + s, FULL, checkpoints=[checkpoint(FULL, s)])) for s in (1, 2, 3)]
    made += [write(folder, f"bare{s}", trained(0.3, BARE, s)) for s in (11, 12, 13, 14)]
    made.append(write(folder, "alone", trained(0.5, "Alone", 21)))
    return [str(path) for path in made]


@pytest.fixture(scope="module")
def methods(files: list[str]) -> list[Method]:
    return read_methods(files)


def cell(sheet, row: int, title: str):
    return sheet.rows[row].values[[column.title for column in sheet.columns].index(title)]


def test_results_of_one_method_from_several_checkpoints_are_its_seeds(methods: list[Method], files: list[str]) -> None:
    assert [(method.name, len(method.runs)) for method in methods] == [(FULL, 3), (BARE, 4), ("Alone", 1)]
    assert [run.limit for run in methods[0].runs] == [31.0, 32.0, 33.0]
    with pytest.raises(UserError, match=r"is the second result of"):
        read_results(files)
    with pytest.raises(UserError, match=r"is the second result of"):
        read_methods([*files, files[0]])


def test_a_result_keeps_its_trials_and_its_figures_are_theirs(methods: list[Method]) -> None:
    at = methods[0].runs[0].at(20.0)
    assert at.each("success").mean() == at.summary["success"].share
    for name in ("max_distance", "traversal_s", "speed", "speed_error", "com_height", "knee_peak"):
        assert np.nanmean(at.each(name)) == pytest.approx(at.summary[name].mean, rel=1e-4), name
    quotient = np.nansum(at.each("weight_work")) / np.nansum(at.each("distance"))
    assert quotient == pytest.approx(at.summary["cost_of_transport"], rel=1e-4)
    assert at.each("unknown") is None
    walked = outcomes(0.5)
    values = trial_values(walked, walked.grade_index == 1, 33.0, 0.5)
    assert {len(of) for of in values.values()} == {24}


def test_table_2_over_seeds_has_means_of_seeds_and_the_papers_rows(methods: list[Method]) -> None:
    sheet = ablation_over_seeds(methods, read_paper())
    assert [row.title for row in sheet.rows[:6]] == [
        FULL,
        "paper: Full",
        BARE,
        f"{BARE}, IQM",
        "paper: w/o BSGA",
        "Alone",
    ]
    assert sheet.rows[0].note == "3 seeds, 20 M steps, harness"
    assert sheet.rows[5].note == "1 seed, 20 M steps, harness"
    height = cell(sheet, 0, "h_com m")
    assert isinstance(height, Estimate)
    assert height.value == pytest.approx(np.mean([run.at(20.0).summary["com_height"].mean for run in methods[0].runs]))
    assert height.low < height.value < height.high
    success = cell(sheet, 0, "SR %")
    shares = [100.0 * run.at(20.0).summary["success"].share for run in methods[0].runs]
    assert success.value == pytest.approx(np.mean(shares))
    assert 0.0 <= success.low < success.high <= 100.0
    # One seed has what it has today.
    assert isinstance(cell(sheet, 5, "SR %"), Proportion)
    assert ONE_SEED_NOTE in sheet.notes
    assert ONE_SEED_NOTE not in ablation_over_seeds(methods[:2], read_paper()).notes


def test_a_figure_without_trials_is_judged_by_its_seeds_alone(methods: list[Method]) -> None:
    quantile = cell(ablation_over_seeds(methods, read_paper()), 0, "τ p99 Nm")
    assert isinstance(quantile, Estimate)
    assert quantile.low == quantile.value == quantile.high  # the same in all seeds here


def test_better_is_said_only_where_the_interval_says_it(methods: list[Method]) -> None:
    sheet = differences(methods)
    assert [row.name for row in sheet.rows] == [BARE, BARE, "Alone", "Alone"]
    assert cell(sheet, 0, "h_com m").high < 0.0
    assert cell(sheet, 1, "h_com m") == "worse"
    assert cell(sheet, 1, "σ²_yaw rad²/s²") == "not separable"
    assert cell(sheet, 1, "speed m/s") == "lower"
    assert {value for value in sheet.rows[3].values if value is not None} == {"one seed"}
    alike = differences([methods[0], Method("twin", methods[0].runs)])
    assert set(alike.rows[1].values) <= {"not separable", None}
    back = differences([methods[1], methods[0]])
    assert cell(back, 1, "h_com m") == "better"
    assert cell(back, 0, "h_com m").value == pytest.approx(-cell(sheet, 0, "h_com m").value)


def test_table_1_over_seeds_averages_the_limits(methods: list[Method]) -> None:
    sheet = main_over_seeds(methods, read_paper())
    limit = sheet.rows[0].values[-1]
    assert limit.value == 32.0
    assert limit.low < 31.0
    assert sheet.rows[-1].source == "paper"
    assert all(len(row.values) == len(sheet.columns) for row in sheet.rows)


def test_limits_of_which_one_may_be_higher_have_no_mean(methods: list[Method]) -> None:
    first, *others = methods[0].runs
    sheet = main_over_seeds([Method(FULL, (replace(first, beyond=True), *others))], read_paper())
    assert sheet.rows[0].values[-1] is None
    said = f"{FULL}: the sweep of 1 of 3 seeds ends at their limit, which may be higher: no mean."
    assert said in sheet.notes
    assert not any("may be higher" in note for note in main_over_seeds(methods, read_paper()).notes)
    alone = main_over_seeds([Method(FULL, (replace(first, beyond=True),))], read_paper())
    assert alone.rows[0].values[-1] == 31.0
    assert f"{FULL}: the sweep ends there, the limit may be higher." in alone.notes


def test_tables_over_seeds_explain_their_metrics_as_tables_of_single_results_do(methods: list[Method]) -> None:
    paper, runs = read_paper(), methods[2].runs
    intervals = {SR_NOTE, MEAN_NOTE}
    single, over_seeds = main_table(runs, paper), main_over_seeds(methods, paper)
    assert set(single.notes) - intervals <= set(over_seeds.notes)
    assert set(ablation_table(runs, paper).notes) - intervals <= set(ablation_over_seeds(methods, paper).notes)
    for word in (
        "SR: share of trials that reach the goal",
        "T_trav: ",
        "MXD stops at",
        "self-contact: ",
        "Max grade: ",
    ):
        assert any(word in note for note in over_seeds.notes), word


def test_the_verb_prints_and_writes_both(files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "t"
    assert main(["table", "2", *files, "--against", BARE, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"Differences from {BARE} at 20°" in said
    assert "Better or worse is said only where" in said
    assert {path.name for path in tmp_path.iterdir()} == {
        f"t{part}.{end}" for part in ("", "-differences") for end in ("md", "csv", "json")
    }
    rows = json.loads((tmp_path / "t-differences.json").read_text())["rows"]
    assert rows[0]["h_com m low"] > 0.0
    assert main(["table", "1", *files]) == 0
    assert main(["table", "cells", *files]) == 0
    assert f"{FULL}, 2 of 3" in capsys.readouterr().out


def test_a_method_to_compare_with_must_be_there(files: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["table", "2", *files, "--against", "Allone"]) == 2
    assert "method 'Allone' does not exist; did you mean 'Alone'?" in capsys.readouterr().err
    assert main(["table", "2", files[0], "--against", FULL]) == 2
    assert "differences need several seeds" in capsys.readouterr().err
