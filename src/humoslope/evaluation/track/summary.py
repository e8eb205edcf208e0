"""The figures of a set of trials on a track, as the paper's tables have them (paper, section 4, "Metrics").

A figure is None where nothing was measured. Averages over trials give each trial the same weight, however long it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from humoslope.evaluation.track.metrics import GROUPS, PROFILE, TORQUE_BIN, TrackTrials
from humoslope.slope.zmp import GRAVITY
from humoslope.statistics import Array, Average, Proportion, average, proportion

DIRECTIONS = {"up": 1, "flat": 0, "down": -1}
LEAST_WAY = 1.0
"""Mean distance of trials below which cost of transport means nothing, m: it divides by the distance."""

Choice = NDArray[np.bool_]
"""Which of T trials."""


class Outcomes(Protocol):
    """T finished trials: how they ended, and what was measured on the way; all arrays are [T].

    Attributes:
        metrics: What was measured.
        success: Whether the goal was reached.
        fell, left, timed_out: How the others ended.
        seconds: Until the end, s; of a success, until the goal.
        max_place: Furthest place on the track, m from its start.
        grade_index, tier_index: The condition each was walked under.
    """

    @property
    def metrics(self) -> TrackTrials: ...
    @property
    def success(self) -> NDArray[np.bool_]: ...
    @property
    def fell(self) -> NDArray[np.bool_]: ...
    @property
    def left(self) -> NDArray[np.bool_]: ...
    @property
    def timed_out(self) -> NDArray[np.bool_]: ...
    @property
    def seconds(self) -> Array: ...
    @property
    def max_place(self) -> Array: ...
    @property
    def grade_index(self) -> NDArray[np.int64]: ...
    @property
    def tier_index(self) -> NDArray[np.int64]: ...


@dataclass(frozen=True)
class Summary:
    """The figures of some trials; what is averaged over trials comes with Student's interval.

    Attributes:
        success: SR, the share of trials that reached the goal, with Wilson's interval.
        fell, left, timed_out: Trials that ended otherwise.
        max_distance: MXD, furthest place from the start of the track, averaged over all trials, m.
        traversal_s: T_trav, time to the goal, averaged over the successes, s.
        speed: Forward speed along the ground, mean of the trials' means, m/s.
        speed_error: Distance of a trial's mean speed from the commanded one, averaged over trials, m/s.
        speed_rms_error: Root mean square of the difference at each instant, m/s.
        cost_of_transport: See `cost_of_transport`; over all trials.
        cost_of_transport_successes: The same over the successes.
        cost_of_transport_positive: The same over all trials, of positive work alone.
        yaw_rate_variance: Over the time of a trial, averaged over trials, (rad/s)^2.
        com_height: Of the centre of mass above the ground right below it, mean of the trials' means, m.
        root_height: As `com_height`, of the root, m.
        knee_peak: Largest torque of either knee in a trial, averaged over trials, Nm.
        knee_max: Largest of all trials, Nm.
        knee_p99: Torque that 99 % of all instants of both knees stay below, to `TORQUE_BIN`, Nm.
    """

    success: Proportion
    fell: int
    left: int
    timed_out: int
    max_distance: Average | None
    traversal_s: Average | None
    speed: Average | None
    speed_error: Average | None
    speed_rms_error: float | None
    cost_of_transport: float | None
    cost_of_transport_successes: float | None
    cost_of_transport_positive: float | None
    yaw_rate_variance: Average | None
    com_height: Average | None
    root_height: Average | None
    knee_peak: Average | None
    knee_max: float
    knee_p99: float | None


def summarise(outcomes: Outcomes, which: Choice, mass: float, commanded: float) -> Summary:
    """The figures of the trials in `which` [T].

    Args:
        mass: Of the robot, kg.
        commanded: Commanded speed, m/s.

    Raises:
        UserError: If there is no trial.
    """
    success, metrics = outcomes.success[which], outcomes.metrics[which]
    return Summary(
        success=proportion(int(success.sum()), len(success)),
        fell=int(outcomes.fell[which].sum()),
        left=int(outcomes.left[which].sum()),
        timed_out=int(outcomes.timed_out[which].sum()),
        max_distance=average(outcomes.max_place[which]),
        traversal_s=average(outcomes.seconds[which][success]),
        speed=average(metrics.speed),
        speed_error=average(np.abs(metrics.speed - commanded)),
        speed_rms_error=rms_speed_error(metrics),
        cost_of_transport=cost_of_transport(metrics, mass),
        cost_of_transport_successes=cost_of_transport(metrics[success], mass),
        cost_of_transport_positive=cost_of_transport(metrics, mass, positive=True),
        yaw_rate_variance=average(metrics.yaw_rate_variance),
        com_height=average(metrics.com_height),
        root_height=average(metrics.root_height),
        knee_peak=average(metrics.knee_peak),
        knee_max=float(metrics.knee_peak.max()),
        knee_p99=knee_quantile(metrics, 0.99),
    )


def rms_speed_error(metrics: TrackTrials) -> float | None:
    """Root mean square difference of the speed at each instant from the commanded one, over all trials, m/s."""
    samples = metrics.samples.sum()
    return float(np.sqrt(metrics.squared_error.sum() / samples)) if samples else None


def cost_of_transport(metrics: TrackTrials, mass: float, positive: bool = False) -> float | None:
    """CoT = sum of |torque x velocity| dt over joints and time / (m g d), with d the way forward along the track.

    Work and way of all trials are summed before they are divided, so that a trial counts by the way it went; a mean of
    ratios would be ruled by those that fell at the start. The way is horizontal, from the first place of a trial to its
    last. The paper does not say which trials and which way it takes.

    Args:
        mass: m, kg.
        positive: Whether only work done by the joints counts, and not the work done on them.

    Returns:
        None if the trials went less than `LEAST_WAY` on average.
    """
    began = ~np.isnan(metrics.distance)
    way = metrics.distance[began].sum()
    if not began.any() or way < LEAST_WAY * began.sum():
        return None
    work = metrics.positive_work if positive else metrics.work
    return float(work[began].sum() / (mass * GRAVITY * way))


def knee_quantile(metrics: TrackTrials, share: float) -> float | None:
    """The |torque| that a `share` of all instants of both knees stay below: the middle of its `TORQUE_BIN`, Nm."""
    counts = metrics.knee_histogram.sum(axis=0, dtype=np.int64)
    total = counts.sum()
    if total == 0:
        return None
    return float((np.searchsorted(np.cumsum(counts), share * total) + 0.5) * TORQUE_BIN)


@dataclass(frozen=True)
class Diagnosis:
    """Posture and load on all segments of one direction; averages over the time spent there, of all trials.

    Attributes:
        torso_pitch: Lean in the heading direction, rad, positive forward.
        knee_flexion: Mean of both knees, rad.
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
        directions: Of each segment: +1 up, 0 flat, -1 down.

    Returns:
        One diagnosis for each of `DIRECTIONS`; None where nobody was.
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
    """What `metrics.PROFILE` names along the track: the mean over the time all trials spent in each bin of place."""
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
