"""Figures of a set of trials on a track, as in the paper's tables (paper, section 4, "Metrics")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from humoslope.evaluation.track.metrics import EACH, GROUPS, PROFILE, REPORTED, Figure, TrialSet
from humoslope.evaluation.track.recorder import TrackTrials
from humoslope.statistics import Array, Bools

DIRECTIONS = {"up": 1, "flat": 0, "down": -1}
ENOUGH = 0.5
"""Success rate from which on a grade counts as mastered; ours, the paper does not say."""


class Outcomes(Protocol):
    """T finished trials: how they ended, and their record; all arrays are [T].

    Attributes:
        metrics: Recorded values.
        success: True where the goal was reached.
        fell, left, timed_out: How the others ended.
        seconds: Until the end, s; of a success, until the goal.
        max_place: Furthest place on the track, m from its start.
        grade_index, tier_index: Condition of each trial.
    """

    @property
    def metrics(self) -> TrackTrials: ...
    @property
    def success(self) -> Bools: ...
    @property
    def fell(self) -> Bools: ...
    @property
    def left(self) -> Bools: ...
    @property
    def timed_out(self) -> Bools: ...
    @property
    def seconds(self) -> Array: ...
    @property
    def max_place(self) -> Array: ...
    @property
    def grade_index(self) -> NDArray[np.int64]: ...
    @property
    def tier_index(self) -> NDArray[np.int64]: ...


Summary = dict[str, Figure]
"""Figures of some trials by the names of `REPORTED`. A result of an older version may lack some."""


def summarise(outcomes: Outcomes, which: Bools, mass: float, commanded: float) -> Summary:
    """All reported metrics of the trials in `which` [T].

    Args:
        mass: Mass of the robot, kg.
        commanded: Commanded speed, m/s.

    Raises:
        UserError: If there is no trial.
    """
    trials = trial_set(outcomes, which, mass, commanded)
    return {name: metric.reduce(trials) for name, metric in REPORTED.items() if metric.reduce is not None}


def trial_values(outcomes: Outcomes, which: Bools, mass: float, commanded: float) -> dict[str, Array]:
    """Values [T] of single trials by the names of `EACH`; arguments as of `summarise`."""
    trials = trial_set(outcomes, which, mass, commanded)
    return {name: each(trials) for name, each in EACH.items()}


def trial_set(outcomes: Outcomes, which: Bools, mass: float, commanded: float) -> TrialSet:
    """The trials in `which`; arguments as of `summarise`."""
    return TrialSet(
        metrics=outcomes.metrics[which],
        success=outcomes.success[which],
        fell=outcomes.fell[which],
        left=outcomes.left[which],
        timed_out=outcomes.timed_out[which],
        seconds=outcomes.seconds[which],
        max_place=outcomes.max_place[which],
        mass=mass,
        commanded=commanded,
    )


@dataclass(frozen=True)
class Diagnosis:
    """Posture and load on all segments of one direction, averaged over the time that all trials spent there.

    Attributes:
        torso_pitch: Lean of the torso in the heading direction, rad, positive forward.
        knee_flexion: Mean flexion of both knees, rad.
        torque: |torque| of a joint of each of `GROUPS`, Nm.
        positive_share, negative_share: Each group's part of the work that the three of them do, and of that done on
            them; None if there was none.
    """

    torso_pitch: float
    knee_flexion: float
    torque: dict[str, float]
    positive_share: dict[str, float] | None
    negative_share: dict[str, float] | None


def diagnose(metrics: TrackTrials, directions: Sequence[int]) -> dict[str, Diagnosis | None]:
    """Posture and load uphill, on the flat and downhill.

    Args:
        directions: Direction of each segment: +1 up, 0 flat, -1 down.

    Returns:
        One diagnosis for each of `DIRECTIONS`; None where no trial came.
    """
    found: dict[str, Diagnosis | None] = {}
    for name, direction in DIRECTIONS.items():
        where = np.array(directions) == direction
        samples = metrics.segment_samples[:, where].sum()
        if samples == 0.0:
            found[name] = None
            continue
        found[name] = Diagnosis(
            torso_pitch=float(metrics.segment_pitch[:, where].sum() / samples),
            knee_flexion=float(metrics.segment_flexion[:, where].sum() / samples),
            torque=_by_group(metrics.segment_torque[:, where].sum(axis=(0, 1)) / samples),
            positive_share=_shares(metrics.segment_positive[:, where].sum(axis=(0, 1))),
            negative_share=_shares(metrics.segment_negative[:, where].sum(axis=(0, 1))),
        )
    return found


def profile(metrics: TrackTrials) -> dict[str, list[float | None]]:
    """Mean of each of `PROFILE` over the time that all trials spent in each bin of place; None where no trial came."""
    samples = metrics.profile_samples.sum(axis=0)
    sums = metrics.profile.sum(axis=0)  # [bins, PROFILE]
    return {
        name: [float(total / n) if n else None for total, n in zip(sums[:, i], samples, strict=True)]
        for i, name in enumerate(PROFILE)
    }


def _by_group(values: NDArray[Any]) -> dict[str, float]:
    return dict(zip(GROUPS, values.tolist(), strict=True))


def _shares(work: NDArray[Any]) -> dict[str, float] | None:
    return _by_group(work / work.sum()) if work.sum() > 0.0 else None


@dataclass(frozen=True)
class SlopeLimit:
    """Result of a sweep. Grades in degrees; None if not even the lowest grade of the sweep qualifies.

    Attributes:
        grade: The steepest grade that is mastered together with all lower ones of the sweep.
        any_success: The steepest grade with at least one success, whatever the lower ones gave.
        beyond: True if the steepest grade of the sweep is mastered, so that the limit lies there or higher.
    """

    grade: float | None
    any_success: float | None
    beyond: bool


def slope_limit(grades: Sequence[float], successes: Sequence[int], trials: Sequence[int]) -> SlopeLimit:
    """The slope limit from the outcomes at each grade, up to the first grade that is not mastered: a steeper one that
    happens to succeed does not count."""
    rising = sorted(zip(grades, successes, trials, strict=True))
    limit: float | None = None
    for grade, count, total in rising:
        if count < ENOUGH * total:
            break
        limit = grade
    reached = [grade for grade, count, _ in rising if count > 0]
    return SlopeLimit(limit, max(reached, default=None), limit == rising[-1][0])
