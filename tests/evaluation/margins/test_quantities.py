"""Grids begin at the nominal setup, or at level ground, and change one thing only; success is what it is said to be."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from humoslope.deploy import contract as contracts
from humoslope.deploy.gait import Gait
from humoslope.deploy.player import Trial, TrialCfg
from humoslope.evaluation.margins.quantities import Name, Success, quantities
from humoslope.evaluation.margins.trials import Setup

GOOD = Trial(False, 20.0, 9.0, 0.5, 9.0, 0.5, 3.0, 0.0, 0.5, 0.0, Gait(0.0, 0.1, 0.5, 0.05))


def test_every_quantity_goes_one_way_and_changes_its_own_field_only(exported: Path) -> None:
    contract, nominal = contracts.read(exported), TrialCfg()
    known = quantities(contract, nominal)
    assert tuple(known) == get_args(Name)
    for name, quantity in known.items():
        grid = quantity.grid
        assert len(set(grid)) == len(grid) > 2
        assert list(grid) in (sorted(grid), sorted(grid, reverse=True))
        changed = set()
        for value in grid[1:]:
            setup = quantity.setup(Setup(nominal), value, 0, np.random.default_rng(0))
            for now, before in ((setup.cfg, nominal), (setup.conditions, Setup(nominal).conditions)):
                changed |= {field for field, x in asdict(now).items() if x != asdict(before)[field]}
        assert len(changed) == 1, name
    for name in ("timestep-fine", "timestep-coarse"):
        for value in known[name].grid:  # type: ignore[index]
            assert 20.0 / value == pytest.approx(round(20.0 / value))
    tilted = known["imu-tilt"].setup(Setup(nominal), 4.0, 0, np.random.default_rng(0)).conditions.imu_tilt_rad
    assert math.hypot(*tilted) == pytest.approx(math.radians(4.0))


def test_a_first_value_is_the_nominal_setup_except_for_ground_without_the_slope_of_the_course(exported: Path) -> None:
    contract = contracts.read(exported)
    step = contract.timing.control_step_s / contract.decimation
    for grade, other in ((0.0, {"yaw-rate"}), (20.0, {"slope-up", "slope-down", "cross-slope", "yaw-rate"})):
        nominal = TrialCfg(grade=grade)
        for name, quantity in quantities(contract, nominal).items():
            cfg, conditions = quantity.setup(Setup(nominal), quantity.grid[0], 0, np.random.default_rng(0))
            assert (cfg == nominal) == (name not in other), name
            # The same conditions in other words.
            assert conditions.friction is None or conditions.friction == pytest.approx(nominal.friction)
            assert conditions.timestep_s is None or conditions.timestep_s == pytest.approx(step)
            assert not any(conditions.encoder_bias_rad)
            spelled = replace(conditions, friction=None, timestep_s=None, encoder_bias_rad=())
            assert spelled == Setup(nominal).conditions, name


def test_success_is_no_fall_the_speed_asked_and_the_course_kept() -> None:
    success, straight, turning = Success(), TrialCfg(), TrialCfg(yaw_rate=0.6)
    assert success(GOOD, straight)
    for wrong in ({"fell": True}, {"speed": 0.34}, {"speed": math.nan}, {"lateral_speed": -0.11}):
        assert not success(replace(GOOD, **wrong), straight)
    circling = replace(GOOD, speed=0.0, yaw_rate=0.55)
    assert success(circling, turning)
    assert not success(circling, replace(turning, yaw_rate=-0.6))
    assert not success(replace(circling, heading_speed=0.7), turning)
