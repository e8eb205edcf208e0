"""Results survive their file, and files of one method are put together."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.evaluation.report.paper import read_paper
from humoslope.evaluation.report.results import Training, TrialSetup, read_methods, read_results, to_report
from humoslope.evaluation.report.tables import ablation_table, causes_table, cells_table, diagnostics_table, main_table
from humoslope.evaluation.track.protocol import HeldOutProtocol
from humoslope.evaluation.track.summary import summarise
from tests.evaluation.made_up import GOAL, GRADES, SEGMENTS, TASK, TIERS, TRIALS, outcomes, report, sweep, write


def told(walked):
    return to_report(walked, grades=GRADES, tiers=TIERS, segments=SEGMENTS, speed=0.5, mass=33.0)


def test_what_was_measured_is_what_is_read(tmp_path):
    walked = outcomes(0.5)
    (result,) = read_results([str(write(tmp_path, "a", report(0.5)))])
    assert (result.name, result.task, result.goal) == (TASK, TASK, GOAL)
    assert result.segments == SEGMENTS
    assert not result.partial
    assert [grade.grade for grade in result.grades] == list(GRADES)
    assert [(c.grade, c.tier) for c in result.cells] == [(g, t) for g in GRADES for t in TIERS]
    steep = walked.grade_index == 2
    assert result.at(20.0).summary == summarise(walked, steep, 33.0, 0.5)
    assert result.cells[4].summary == summarise(walked, (walked.grade_index == 1) & (walked.tier_index == 1), 33.0, 0.5)
    assert result.at(20.0).summary["success"].total == len(TIERS) * TRIALS
    assert result.at(20.0).diagnosis["up"].torso_pitch == pytest.approx(0.3)
    assert result.at(25.0) is None


@given(speed=st.floats(0.1, 2.0), start=st.floats(0.0, 10.0), way=st.floats(0.0, 20.0), grade=st.floats(0.0, 45.0))
def test_the_commanded_time_is_the_way_along_the_ground_over_the_speed(speed, start, way, grade):
    setup = TrialSetup(speed, start, start + way, SEGMENTS)
    # The same by small steps: the ground is longer than its shadow where a segment slopes.
    x = start + way * (np.arange(4000) + 0.5) / 4000
    ends = np.cumsum([s.length for s in SEGMENTS])
    slopes = np.array([s.direction for s in SEGMENTS])[np.searchsorted(ends, x, side="right")] != 0
    along = np.where(slopes, 1.0 / math.cos(math.radians(grade)), 1.0).sum() * way / 4000
    assert setup.commanded_seconds(grade) == pytest.approx(along / speed, rel=2e-3, abs=1e-9)


def test_the_commanded_time_of_the_held_out_track_is_the_known_one():
    protocol = HeldOutProtocol()
    setup = TrialSetup(protocol.speed, protocol.start_place, protocol.success_place, protocol.find_course().segments)
    assert [round(setup.commanded_seconds(g), 1) for g in protocol.grades] == [62.0, 62.6, 64.7, 68.5]


def test_cells_say_their_friction():
    cell = told(outcomes(0.5))["cells"][-1]
    assert (cell["grade"], cell["tier"]) == (30.0, 0.9)
    assert cell["friction"] == pytest.approx(1.4774, abs=1e-4)


def test_how_many_trials_came_how_far():
    walked = outcomes(0.5)
    grade = told(walked)["grades"][3]
    there = walked.max_place[walked.grade_index == 3]
    assert grade["reached"][0] == len(there)
    assert grade["reached"][20] == (there >= 10.0).sum()
    assert grade["reached"][63] == walked.success[walked.grade_index == 3].sum()
    assert len(grade["reached"]) == 71
    assert grade["reached"][64:] == [0] * 7


def test_a_goal_reached_within_rounding_is_reached():
    walked = outcomes(1.0)
    walked.max_place = np.full(len(walked.success), 31.4999996)
    assert told(walked)["grades"][0]["reached"][63] == len(TIERS) * TRIALS


def test_conditions_without_a_trial_are_left_out():
    walked = outcomes(0.5)
    some = (walked.grade_index == 1) & (walked.tier_index == 2)
    few = type(walked)(**{name: value[some] for name, value in vars(walked).items()})
    found = told(few)
    assert [grade["grade"] for grade in found["grades"]] == [10.0]
    assert [(cell["grade"], cell["tier"]) for cell in found["cells"]] == [(10.0, 0.9)]


def test_a_sweep_joins_the_trials_of_its_method_and_names_tell_methods_apart(tmp_path):
    write(tmp_path, "a", report())
    write(tmp_path, "b", sweep(33.0, slope_limit={"grade": 33.0, "any_success": 35.0, "beyond": True}))
    other = write(tmp_path, "c", report(task="Other"))
    named = write(tmp_path, "d", report(task="Other"))
    other.rename(tmp_path / "c.txt")
    named.rename(tmp_path / "d.txt")
    first, second, third = read_results([str(tmp_path), f"{tmp_path / 'c.txt'}", f"Mine={tmp_path / 'd.txt'}"])
    assert (first.name, first.limit, first.swept, first.beyond) == (TASK, 33.0, True, True)
    assert first.at(20.0) is not None
    assert (second.name, second.limit, second.swept) == ("Other", None, False)
    assert (third.name, third.task) == ("Mine", "Other")


@pytest.mark.parametrize("read", [read_results, read_methods])
def test_a_sweep_of_another_checkpoint_is_not_joined(tmp_path, read):
    def told_of(made, *hashes):
        return made | {"checkpoints": [made["checkpoints"][0] | {"sha256": sha256} for sha256 in hashes]}

    track = write(tmp_path, "track", told_of(report(), "a", "b"))
    same, other = (
        write(tmp_path, "same", told_of(sweep(33.0), "b", "a")),
        write(tmp_path, "other", told_of(sweep(33.0), "c")),
    )
    (one,) = read([f"mine={track}", f"mine={same}"])
    assert [run.limit for run in getattr(one, "runs", (one,))] == [33.0]
    with pytest.raises(UserError) as error:
        read([f"mine={track}", f"mine={other}"])
    assert f"'{track}' and '{other}' are both of 'mine', but of different checkpoints" in str(error.value)


def test_a_partial_sweep_has_found_nothing_yet(tmp_path):
    (result,) = read_results([str(write(tmp_path, "a", sweep(None) | {"slope_limit": None}))])
    assert (result.limit, result.swept) == (None, True)
    assert result.grades == ()


@pytest.mark.parametrize(
    ("first", "second", "left"),
    [(None, None, None), (0.25, 0.0, 0.0), (0.25, None, 0.0), (0.0, 0.5, 0.5), (None, 0.5, 0.5)],
)
def test_training_counts_every_stage_and_tells_the_harness_of_the_last(tmp_path, first, second, left):
    before = {"task": "One", "total_steps": 38, "harness": first, "ancestor": None}
    after = {"task": "Two", "total_steps": 23, "harness": second, "ancestor": before}
    plain = {"task": "Two", "total_steps": 5, "harness": None, "ancestor": None}
    (result,) = read_results([str(write(tmp_path, "a", report(checkpoints=[after, plain])))])
    assert result.training == (Training((38, 23), left), Training((5,), None))


def test_missing_trials_make_a_result_partial(tmp_path):
    (result,) = read_results([str(write(tmp_path, "a", report(finished=40)))])
    assert result.partial


def test_mistakes_are_said_in_one_sentence(tmp_path):
    def said(*sources):
        with pytest.raises(UserError) as error:
            read_results([str(source) for source in sources])
        return str(error.value)

    good = write(tmp_path, "good", report())
    assert "does not exist" in said(tmp_path / "nothing.json")
    assert "is the second result of" in said(good, good)
    (tmp_path / "bad.json").write_text("{")
    assert "is not a readable JSON file" in said(tmp_path / "bad.json")
    for changed in ({"what": "ramps"}, {"checkpoints": []}, {"grades": [{"grade": 0.0}]}, {"cells": None}):
        odd = write(tmp_path, "odd", report() | changed)
        assert "is not a result of `humoslope evaluate`" in said(odd)
    (tmp_path / "list.json").write_text(json.dumps([1, 2]))
    assert "is not a result of `humoslope evaluate`" in said(tmp_path / "list.json")
    (tmp_path / "empty").mkdir()
    assert "there are no results in" in said(tmp_path / "empty")
    assert "there are no results in nothing" in said()


def test_a_result_of_an_older_version_lacks_only_the_metrics_that_it_did_not_have(tmp_path):
    old = report(0.5)
    for cell in old["cells"]:
        del cell["summary"]["knee_p99"]
    (result,) = read_results([str(write(tmp_path, "a", old))])
    shown = cells_table([result])
    column = [column.label for column in shown.columns].index("τ p99")
    assert {row.values[column] for row in shown.rows} == {None}


SHIPPED = sorted((Path(__file__).parents[3] / "experiments" / "results").glob("*/*.json"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_the_shipped_tables_are_those_of_the_shipped_results(path):
    results = read_results([str(path)])
    sheets = [cells_table(results)]
    if path.parent.name != "sweep":
        paper = read_paper()
        tables = [main_table(results, paper), ablation_table(results, paper), diagnostics_table(results)]
        named = any(grade.causes is not None for grade in results[0].grades)  # not in results of before causes were
        sheets = [*tables, *([causes_table(results)] if named else []), *sheets]
    assert path.with_suffix(".csv").read_text() == sheets[-1].to_csv()
    assert path.with_suffix(".md").read_text() == "\n".join(sheet.to_markdown() for sheet in sheets)
