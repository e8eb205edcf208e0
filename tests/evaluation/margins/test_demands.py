"""Every demand can be asked, is measured as it says, and is met within its bounds only."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest

from humoslope.deploy import contract as contracts
from humoslope.deploy.gait import Gait
from humoslope.deploy.player import Player, Trial
from humoslope.evaluation.margins.acceptance import Acceptance, _key
from humoslope.evaluation.margins.demands import Demand, Name, demands
from humoslope.evaluation.margins.trials import Job
from humoslope.interrupts import Interrupt

ALL = demands(20.0, 0)
GOOD = Trial(False, 20.0, 9.0, 0.5, 9.0, 0.01, 2.5, 0.0, 0.5, 0.0, Gait(0.005, 0.15, math.radians(30.0), 0.05))


def figure(name: Name, case: int = 0, *trials: Trial) -> float:
    demand = ALL[name]
    return demand.measure(trials, demand.cases[case].setup.cfg)


def test_names_and_demands_agree_and_cases_of_a_demand_differ() -> None:
    assert tuple(ALL) == get_args(Name)
    for demand in ALL.values():
        assert len({_key(case) for case in demand.cases}) == len({case.words for case in demand.cases})
        assert len({case.words for case in demand.cases}) == len(demand.cases)


def test_every_case_is_a_course_that_a_player_can_be_built_for(exported: Path) -> None:
    contract = contracts.read(exported)
    kinds = {
        (c.setup.cfg.straight, c.setup.cfg.cross, c.setup.conditions.timestep_s): c
        for d in ALL.values()
        for c in d.cases
    }
    for case in kinds.values():
        player = Player(exported, contract, case.setup.cfg, case.setup.conditions)
        player.start()
        player.step(player.course_command())
        assert not player.world.fallen()


def test_the_bounds_of_a_demand_are_met_at_their_ends_and_nan_meets_none() -> None:
    demand = ALL["speed"]
    assert [demand.met(v) for v in (0.42, 0.43, 0.5, 0.57, 0.58, math.nan)] == [False, True, True, True, False, False]
    assert ALL["double-support"].met(10.0)
    assert not ALL["double-support"].met(9.9)
    assert not ALL["push-falls"].met(10.1)
    assert (demand.wanted, ALL["push-falls"].wanted) == ("0.43 to 0.57", "at most 10")
    assert ALL["double-support"].wanted == "at least 10"


@pytest.mark.parametrize(
    ("name", "figures"),
    [
        ("speed", (0.5, 0.4, 0.62, math.nan)),
        ("push-falls", (0.0, 10.0, 20.0)),
        ("double-support", (30.0, 11.0, 2.0)),
    ],
)
def test_the_worst_of_several_figures_is_the_one_furthest_on_the_wrong_side(name: Name, figures: list[float]) -> None:
    demand: Demand = ALL[name]
    assert sorted(figures, key=demand.excess) == list(figures)


def test_figures_are_means_over_the_trials_that_tell_them_in_the_unit_of_the_demand() -> None:
    fell = replace(GOOD, fell=True, speed=math.nan, step_rate=math.nan, gait=Gait(*[math.nan] * 4))
    assert figure("step-rate", 0, GOOD, replace(GOOD, step_rate=2.0), fell) == pytest.approx(2.25)
    assert math.isnan(figure("step-rate", 0, fell))
    assert math.isnan(figure("speed", 0, fell))
    assert math.isnan(figure("backward", 0, fell))
    assert figure("push-falls", 0, GOOD, fell) == 50.0
    assert figure("self-contact", 0, GOOD) == pytest.approx(0.5)
    assert figure("knee-flexion", 0, GOOD) == pytest.approx(30.0)
    assert figure("double-support", 0, GOOD) == pytest.approx(15.0)
    assert figure("fast-targets", 0, GOOD) == pytest.approx(5.0)


def test_errors_are_against_what_was_asked_and_slips_count_downhill() -> None:
    right = next(i for i, case in enumerate(ALL["sideways"].cases) if case.setup.cfg.lateral < 0.0)
    assert figure("sideways", right, replace(GOOD, lateral_speed=-0.25)) == pytest.approx(0.05)
    assert figure("backward", 0, replace(GOOD, speed=-0.2)) == pytest.approx(0.1)
    assert figure("turning", 0, replace(GOOD, yaw_rate=0.55)) == pytest.approx(0.05)
    rises_left, rises_right = (
        next(i for i, c in enumerate(ALL["across-slip"].cases) if c.setup.cfg.cross == x) for x in (20, -20)
    )
    assert figure("across-slip", rises_left, replace(GOOD, lateral_speed=-0.3)) == pytest.approx(0.3)
    assert figure("across-slip", rises_right, replace(GOOD, lateral_speed=-0.3)) == pytest.approx(-0.3)


def test_errors_to_either_side_do_not_make_up_for_each_other() -> None:
    sideways = [replace(GOOD, lateral_speed=speed) for speed in (0.0, 0.6)]  # asked: 0.3
    assert figure("sideways", 0, *sideways) == pytest.approx(0.3)
    backward = [replace(GOOD, speed=speed) for speed in (-0.25, -0.45, math.nan)]  # asked: -0.3
    assert figure("backward", 0, *backward) == pytest.approx(0.1)
    turning = [replace(GOOD, yaw_rate=rate) for rate in (0.0, 1.2)]  # asked: 0.6
    assert figure("turning", 0, *turning) == pytest.approx(0.6)


def test_an_imu_is_tilted_by_the_same_angle_about_another_axis_in_each_trial() -> None:
    case = ALL["imu-falls"].cases[0]
    tilts = [case.trial(i).conditions.imu_tilt_rad for i in range(3)]
    assert [math.hypot(*tilt) for tilt in tilts] == pytest.approx([math.radians(4.0)] * 3)
    assert len(set(tilts)) == 3
    assert case.trial(1) == case.trial(1)


def test_an_acceptance_runs_shared_cases_once_and_names_the_worst(
    exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A policy that is slow down 20 degrees and falls under load."""
    jobs: list[Job] = []

    def made_up(job: Job) -> Trial:
        jobs.append(job)
        fell = job.setup.conditions.load_kg > 0.0 and job.trial == 0
        return replace(GOOD, fell=fell, speed=0.3 if job.setup.cfg.grade == -20.0 else 0.5)

    monkeypatch.setattr("humoslope.evaluation.margins.trials.run_job", made_up)
    names: tuple[Name, ...] = ("speed", "falls", "self-contact")

    def make() -> Acceptance:
        return Acceptance(exported, names, 2, 20.0, 0, None, tmp_path / "trials.json")

    whole = make()
    assert whole.run(Interrupt(), 1)
    assert len(jobs) == 2 * 33  # those of self-contact are among the others
    report = whole.report()
    assert [demand["met"] for demand in report["demands"].values()] == [False, False, True]
    assert not report["met"]
    assert report["demands"]["speed"]["worst"].startswith("-20°")
    assert report["demands"]["falls"]["cases"]["20°, 8 kg"] == {"figure": 50.0, "falls": 1, "met": False}
    again = make()
    assert again.run(Interrupt(), 1)
    assert len(jobs) == 2 * 33  # all were kept
    assert again.report() == report
