"""Results of evaluations that never happened, for tests of what is made of them."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from humoslope.evaluation.report.results import to_report
from humoslope.evaluation.track.metrics import BIN, GROUPS, PROFILE, RECORDED
from humoslope.evaluation.track.recorder import TrackTrials
from humoslope.terrain.course import Segment

GRADES, TIERS, TRIALS = (0.0, 10.0, 20.0, 30.0), (0.3, 0.6, 0.9), 8
SEGMENTS = (
    Segment("start", 2.0, 0, "smooth"),
    Segment("up smooth", 8.0, 1, "smooth"),
    Segment("plateau", 5.0, 0, "smooth"),
    Segment("down wavy", 10.0, -1, "wavy"),
    Segment("end", 10.0, 0, "rough"),
)
LENGTH, GOAL = 35.0, 31.5  # m
TASK = "HumoSlope-Made-Up-Unitree-G1"


def outcomes(skill: float, seed: int = 0, trials: int = TRIALS) -> SimpleNamespace:
    """Trials of a method of that skill in [0, 1]; it gets worse with grade and better with friction."""
    rng = np.random.default_rng(seed)
    cells = [(g, t) for g in range(len(GRADES)) for t in range(len(TIERS)) for _ in range(trials)]
    grade, tier = (np.array(index, dtype=np.int64) for index in zip(*cells, strict=True))
    count = len(cells)
    chance = np.clip(skill + 0.6 - 0.35 * grade + 0.1 * tier, 0.0, 1.0)
    success = rng.uniform(size=count) < chance
    place = np.where(success, GOAL, rng.uniform(1.0, 20.0, size=count))
    bins = round(LENGTH / BIN)
    middle = BIN * (np.arange(bins) + 0.5)
    walked = (middle < place[:, None]) * 50.0
    direction = np.repeat([s.direction for s in SEGMENTS], [round(s.length / BIN) for s in SEGMENTS])
    steep = np.radians(np.array(GRADES))[grade][:, None] * direction  # [T, bins]
    along = np.stack(
        [
            20.0 + 40.0 * np.maximum(steep, 0.0) + 2.0 * np.sin(middle),
            0.7 - 0.4 * np.minimum(steep, 0.0) - 0.2 * skill + 0.0 * middle,
            0.6 + 0.08 * skill + 0.05 * steep,
            0.3 * steep + 0.02,
        ],
        axis=2,
    )
    assert along.shape[2] == len(PROFILE)
    by_segment = np.stack(
        [
            walked[:, start : start + n].sum(axis=1)
            for start, n in zip((0, 4, 20, 30, 50), (4, 16, 10, 20, 20), strict=True)
        ],
        axis=1,
    )
    slope = np.array([s.direction for s in SEGMENTS])
    of_groups = by_segment[:, :, None] * np.array([20.0, 30.0, 15.0])
    assert of_groups.shape[2] == len(GROUPS)
    peaks = 70.0 + 15.0 * grade + rng.normal(scale=4.0, size=count)
    # Metrics that these tests know nothing of have some numbers as well.
    values = {metric.name: rng.uniform(size=count) for metric in RECORDED} | {
        "work": 80.0 * (2.0 - skill) * place,
        "positive_work": 50.0 * (2.0 - skill) * place,
        "speed": 0.4 + 0.1 * skill + rng.normal(scale=0.01, size=count),
        "squared_error": 0.01 * walked.sum(axis=1),
        "yaw_rate_variance": 0.05 + 0.01 * rng.uniform(size=count),
        "com_height": 0.6 + 0.08 * skill - 0.01 * grade + rng.normal(scale=0.004, size=count),
        "root_height": 0.7 + rng.normal(scale=0.004, size=count),
        "knee_peak": peaks,
    }
    metrics = TrackTrials(
        values=values,
        samples=walked.sum(axis=1),
        distance=place - 0.5,
        knee_histogram=np.tile(np.arange(140, 0, -1, dtype=np.int32), (count, 1)),
        segment_samples=by_segment,
        segment_pitch=by_segment * (0.1 + 0.2 * slope),
        segment_flexion=by_segment * (0.6 - 0.1 * slope),
        segment_torque=of_groups,
        segment_positive=of_groups,
        segment_negative=of_groups[:, :, ::-1],
        profile_samples=walked,
        profile=along * walked[:, :, None],
    )
    return SimpleNamespace(
        metrics=metrics,
        success=success,
        fell=~success,
        left=np.zeros(count, dtype=bool),
        timed_out=np.zeros(count, dtype=bool),
        seconds=np.where(success, 62.0 - 10.0 * skill + rng.normal(size=count), 20.0),
        max_place=place,
        grade_index=grade,
        tier_index=tier,
    )


def report(skill: float = 0.5, task: str = TASK, **changes: Any) -> dict[str, Any]:
    """What `humoslope evaluate` leaves of it."""
    walked = outcomes(skill)
    checkpoint = {"task": task, "total_steps": 40_000_000, "harness": 0.0, "iteration": 7, "ancestor": None}
    told = to_report(walked, grades=GRADES, tiers=TIERS, segments=SEGMENTS, speed=0.5, mass=33.0)
    return {
        "what": "held-out",
        "checkpoints": [checkpoint],
        "protocol": {"success_place": GOAL, "start_place": 0.5, "speed": 0.5},
        "trials": len(walked.success),
        "finished": len(walked.success),
        **told,
    } | changes


def sweep(limit: float | None, task: str = TASK, **changes: Any) -> dict[str, Any]:
    """What `humoslope evaluate --sweep` leaves."""
    return (
        report(task=task)
        | {
            "what": "sweep",
            "slope_limit": {"grade": limit, "any_success": limit, "beyond": False},
        }
        | changes
    )


def write(folder: Path, name: str, told: dict[str, Any]) -> Path:
    """The report as a file."""
    path = folder / f"{name}.json"
    path.write_text(json.dumps(told, allow_nan=False))
    return path
