"""Stage II and its ablations differ from one another, and from Stage I, in what they say and in nothing else."""

from __future__ import annotations

import pytest

from humoslope.provenance import plain
from humoslope.registry import build_task

FULL = "HumoSlope-Stage2-Unitree-G1"
BSGA = {"com_height", "hip_propulsion", "knee_braking", "stride", "swing_hip"}
ABLATIONS = {
    "HumoSlope-Stage2-NoZMP-Unitree-G1": {"start.task", "start.shipped"},
    "HumoSlope-Stage2-NoCriticCue-Unitree-G1": {"env.observations.critic"},
    "HumoSlope-Stage2-NoRewardPriors-Unitree-G1": {"env.rewards", "env.observers.slope_gait", "start.calibrated"},
    "HumoSlope-Stage2-NoBSGA-Unitree-G1": {
        *("env.observations.critic", "env.rewards", "env.observers.slope_gait", "start.calibrated")
    },
}


def differences(a: object, b: object, path: str = "") -> set[str]:
    """Paths at which two plain configurations differ."""
    if isinstance(a, dict) and isinstance(b, dict):
        return {d for key in a.keys() | b.keys() for d in differences(a.get(key), b.get(key), f"{path}.{key}")}
    return set() if a == b else {path.removeprefix(".")}


def rewards(task: str) -> set[str]:
    return set(dict(build_task(task).env.rewards.items()))


@pytest.mark.parametrize("task", ABLATIONS)
def test_an_ablation_differs_from_the_full_task_only_in_what_it_takes_away(task):
    found = differences(plain(build_task(FULL)), plain(build_task(task)))
    assert found
    for path in found:
        assert any(path == allowed or path.startswith(f"{allowed}.") for allowed in ABLATIONS[task]), path


def test_the_actor_of_stage_2_is_that_of_stage_1():
    first, second = (plain(build_task(task).env.observations.actor) for task in ("HumoSlope-Stage1-Unitree-G1", FULL))
    assert first == second


def test_the_critic_of_stage_2_sees_the_scan_and_the_descriptor():
    terms = build_task(FULL).env.observations.critic.terms
    assert "height_scan" in terms
    assert "terrain_descriptor" in terms
    assert (
        "terrain_descriptor" not in build_task("HumoSlope-Stage2-NoCriticCue-Unitree-G1").env.observations.critic.terms
    )


def test_stage_2_has_bsga_in_place_of_zmp_and_of_fixed_heights_and_knees():
    first, second = rewards("HumoSlope-Stage1-Unitree-G1"), rewards(FULL)
    assert second - first == BSGA
    assert first - second == {"zmp", "root_height", "knee_flexion"}
    without = rewards("HumoSlope-Stage2-NoBSGA-Unitree-G1")
    assert first - without == {"zmp"}
    assert without <= first


def test_stage_2_has_no_harness():
    cfg = build_task(FULL).env
    assert "harness" not in cfg.events
    assert "harness" not in cfg.curriculum
