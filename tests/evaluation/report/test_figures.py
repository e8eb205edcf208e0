"""Figures show what the results say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from matplotlib.figure import Figure

from humoslope.errors import UserError
from humoslope.evaluation.report.figures import along_track, com_height_by_grade, draw_all, success_by_grade, survival
from humoslope.evaluation.report.results import Result, read_results
from tests.evaluation.made_up import GOAL, SEGMENTS, TIERS, report, sweep, write


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> list[Result]:
    folder = tmp_path_factory.mktemp("results")
    write(folder, "a", report(0.9, "Good"))
    write(folder, "b", report(0.2, "Bad", finished=40))
    return read_results([str(folder)])


def named(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_every_figure_names_its_methods_and_which_are_partial(results):
    for draw in (com_height_by_grade, success_by_grade, survival):
        figure = Figure()
        draw(results, figure)
        assert named(figure) == ["Good", "Bad (partial)"]


def test_the_height_of_the_centre_of_mass_is_drawn_at_each_grade(results):
    figure = Figure()
    com_height_by_grade(results, figure)
    drawn = figure.axes[0].containers[0].lines[0].get_ydata()
    assert list(drawn) == [grade.summary["com_height"].mean for grade in results[0].grades]


def test_millimetres_are_not_drawn_as_a_change_of_posture(results):
    figure = Figure()
    com_height_by_grade(results[:1], figure)
    low, high = figure.axes[0].get_ylim()
    assert high - low > 0.0999


def test_success_is_drawn_with_its_interval_in_a_panel_for_each_tier(results):
    figure = Figure()
    success_by_grade(results, figure)
    assert [axis.get_title(loc="left") for axis in figure.axes] == [f"friction tan(grade) + {t:g}" for t in TIERS]
    points, _, (bars,) = figure.axes[1].containers[1].lines
    rates = [cell.summary["success"] for cell in results[1].cells if cell.tier == 0.6]
    assert list(points.get_ydata()) == pytest.approx([100.0 * rate.share for rate in rates])
    ends = np.array([segment[:, 1] for segment in bars.get_segments()])
    assert ends == pytest.approx(np.array([[100.0 * rate.low, 100.0 * rate.high] for rate in rates]))


def test_survival_falls_from_all_trials_to_the_success_rate_at_the_goal(results):
    figure = Figure()
    survival(results, figure)
    assert [axis.get_title(loc="left") for axis in figure.axes] == ["0°", "10°", "20°", "30°"]
    for axis, grade in zip(figure.axes, results[1].grades, strict=True):
        x, y = axis.lines[1].get_data()
        assert (x[0], y[0]) == (0.0, 100.0)
        assert (x[-1], y[-1]) == (GOAL, pytest.approx(100.0 * grade.summary["success"].share))
        assert (np.diff(y) <= 0.0).all()


def test_torque_and_flexion_are_drawn_along_the_track_over_its_named_segments(results):
    figure = Figure()
    along_track(results, 20.0, figure)
    ground, torque, flexion = figure.axes
    assert [text.get_text() for text in ground.texts if text.get_text()] == ["smooth", "wavy"]
    assert len(ground.texts) == len(SEGMENTS)
    assert ground.lines[0].get_ydata()[2] == pytest.approx(8.0 * math.tan(math.radians(20.0)))
    shown = flexion.lines[0].get_ydata()
    assert shown[40] == pytest.approx(math.degrees(results[0].at(20.0).profile["knee_flexion"][40]))
    assert torque.lines[0].get_xdata()[0] == 0.25
    assert np.nanmax(torque.lines[0].get_xdata()) == GOAL - 0.25


def test_a_grade_that_nobody_walked_is_not_drawn_along_the_track(results, tmp_path):
    files = draw_all(results, tmp_path / "pictures", 25.0)
    assert {file.name for file in files} == {"com_height.png", "success.png", "survival.png"}
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in files)


def test_there_is_nothing_to_draw_of_a_sweep_alone(tmp_path):
    results = read_results([str(write(tmp_path, "a", sweep(30.0)))])
    with pytest.raises(UserError, match="nothing to draw"):
        draw_all(results, tmp_path, 20.0)


def test_a_folder_that_cannot_be_written_to_is_a_mistake(results, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=r"cannot write '.*file/[\w-]+\.\w+': '.*/file' is a file, not a folder\.$"):
        draw_all(results, tmp_path / "file", 20.0)
