"""Definitions of the figures of a track evaluation. A new metric is one more entry of `METRICS`, and nothing else.

A metric with a `sample` is recorded: at every control step the recorder takes the sample of each env and combines the
samples of a trial. A metric with a `reduce` is reported: it turns a set of trials into one figure, which appears in the
result file and in the table by cell, and, where a table names it, in that table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from torch import Tensor

from humoslope.scene.signals import CONTACT_FORCE
from humoslope.slope.zmp import GRAVITY
from humoslope.statistics import Array, Average, Bools, Proportion, average, largest, proportion

if TYPE_CHECKING:
    from humoslope.evaluation.track.recorder import StepSample, TrackTrials

METRICS_VERSION = 1
"""Version of all definitions in this file and in `recorder`, part of the fingerprint of saved trials.

Raise it whenever a recorded number changes its meaning while its name stays: another sample, another way of combining
samples, another settling time, another bin. Trials saved under another version are run again and never pooled with new
ones. Adding, removing or renaming a recorded metric needs no new version: the names are in the fingerprint too. Nor
does a change of `reduce`, which is applied anew whenever results are written.
"""

SETTLE_S = 1.0
"""Time before averages over time begin, s: the robot starts from rest. Energy and peaks count from the start."""
BIN = 0.5
"""Extent of a bin of place, m, for profiles along the track."""
TORQUE_BIN = 1.0
"""Resolution of quantiles of the knee torque, Nm."""
GROUPS = {"hip": ".*hip_pitch.*", "knee": ".*knee.*", "ankle": ".*ankle_pitch.*"}
"""Joints that bend a leg in the plane of walking, both legs in each group, as regular expressions on whole names.
Bending a knee is positive."""
LEAST_WAY = 1.0
"""Mean distance of trials below which no cost of transport is reported, m: it divides by the distance."""

Figure = Proportion | Average | float | None
"""A figure of a set of trials; None where nothing was measured."""


@dataclass(frozen=True)
class TrialSet:
    """Finished trials that one figure is computed from; all arrays are [T].

    Attributes:
        metrics: Recorded values.
        success, fell, left, timed_out: How the trials ended.
        seconds: Duration, s; of a success, until the goal.
        max_place: Furthest place on the track, m from its start.
        mass: Mass of the robot, kg.
        commanded: Commanded speed, m/s.
    """

    metrics: TrackTrials
    success: Bools
    fell: Bools
    left: Bools
    timed_out: Bools
    seconds: Array
    max_place: Array
    mass: float
    commanded: float

    def recorded(self, name: str) -> Array:
        """Values [T] of the recorded metric `name`; NaN where a trial ended before it had settled."""
        return self.metrics.values[name]


@dataclass(frozen=True)
class Metric:
    """A figure of the track.

    Attributes:
        name: Key in saved trials and in result files.
        label, unit, digits: Heading and number of decimals of its column.
        sample: Value of each env at one control step, [M]; None if the metric is computed from other recorded values.
        combine: How the samples of a trial become its value. "mean", "variance" and "sum" are over the control steps
            after `SETTLE_S`; "integral" is over the time between the first and the last sample (in the sample's unit
            times s); "max" is over all samples.
        reduce: Figure of a set of trials; None for a metric that is recorded for others to use and not reported.
        interval: True if the figure has bounds, i.e. is a `Proportion` or an `Average`.
        paper: Key of the same figure in the transcription of the paper's tables; "" if the paper does not have it.
    """

    name: str
    label: str = ""
    unit: str = ""
    digits: int = 2
    sample: Callable[[StepSample], Tensor] | None = None
    combine: Literal["mean", "variance", "sum", "integral", "max"] = "mean"
    reduce: Callable[[TrialSet], Figure] | None = None
    interval: bool = False
    paper: str = ""


def recorded_average(name: str) -> Callable[[TrialSet], Figure]:
    """Average over trials of a recorded metric. Each trial has the same weight, however long it was."""
    return lambda trials: average(trials.recorded(name))


def rms_speed_error(trials: TrialSet) -> float | None:
    """Root mean square difference of the speed at each instant from the commanded one, over all trials, m/s."""
    samples = trials.metrics.samples.sum()
    return float(np.sqrt(trials.recorded("squared_error").sum() / samples)) if samples else None


def cost_of_transport(metrics: TrackTrials, mass: float, work: str = "work") -> float | None:
    """CoT = sum of |torque x velocity| dt over joints and time / (m g d), with d the forward distance along the track.

    Work and distance of all trials are summed before they are divided, so that a trial counts in proportion to its
    distance; a mean of ratios would be dominated by trials that fell at the start. The distance is horizontal, from the
    first place of a trial to its last. The paper does not say which trials and which distance it takes.

    Args:
        mass: m, kg.
        work: Recorded metric with the work of each trial, J.

    Returns:
        None if the mean distance of the trials is below `LEAST_WAY`.
    """
    began = ~np.isnan(metrics.distance)
    way = metrics.distance[began].sum()
    if not began.any() or way < LEAST_WAY * began.sum():
        return None
    return float(metrics.values[work][began].sum() / (mass * GRAVITY * way))


def knee_quantile(metrics: TrackTrials, share: float) -> float | None:
    """|torque| that a `share` of all instants of both knees stay below: the middle of its `TORQUE_BIN`, Nm."""
    counts = metrics.knee_histogram.sum(axis=0, dtype=np.int64)
    total = counts.sum()
    if total == 0:
        return None
    return float((np.searchsorted(np.cumsum(counts), share * total) + 0.5) * TORQUE_BIN)


METRICS: tuple[Metric, ...] = (
    # SR: share of trials that reached the goal, with Wilson's interval.
    Metric(
        "success",
        "SR",
        "%",
        1,
        reduce=lambda t: proportion(int(t.success.sum()), len(t.success)),
        interval=True,
        paper="sr",
    ),
    # MXD: furthest place from the start of the track, over all trials. A success ends a trial, and with it MXD.
    Metric("max_distance", "MXD", "m", 2, reduce=lambda t: average(t.max_place), interval=True, paper="mxd"),
    # T_trav: time to the goal, over the successes.
    Metric(
        "traversal_s",
        "T_trav",
        "s",
        1,
        reduce=lambda t: average(t.seconds[t.success]),
        interval=True,
        paper="t_trav",
    ),
    Metric("fell", "fell", "", 0, reduce=lambda t: int(t.fell.sum())),
    Metric("left", "left", "", 0, reduce=lambda t: int(t.left.sum())),
    Metric("timed_out", "timed out", "", 0, reduce=lambda t: int(t.timed_out.sum())),
    # Forward speed along the ground: mean of the trials' means.
    Metric("speed", "speed", "m/s", 3, lambda s: s.speed, reduce=recorded_average("speed"), interval=True),
    Metric(
        "squared_error",  # summed squared difference of that speed from the commanded one, (m/s)^2
        sample=lambda s: (s.speed - s.commanded).square(),
        combine="sum",
    ),
    # Difference of a trial's mean speed from the commanded one, so that slow and fast trials do not cancel.
    Metric(
        "speed_error",
        "error",
        "m/s",
        3,
        reduce=lambda t: average(np.abs(t.recorded("speed") - t.commanded)),
        interval=True,
    ),
    Metric("speed_rms_error", "RMS", "m/s", 3, reduce=rms_speed_error),
    # Work of all joints: |torque x velocity|, and torque x velocity where it is positive, J.
    Metric("work", sample=lambda s: s.power.abs().sum(dim=1), combine="integral"),
    Metric("positive_work", sample=lambda s: s.driving_power.sum(dim=1), combine="integral"),
    Metric("cost_of_transport", "CoT", "", 3, reduce=lambda t: cost_of_transport(t.metrics, t.mass), paper="cot"),
    Metric(
        "cost_of_transport_successes",
        "CoT of successes",
        "",
        3,
        reduce=lambda t: cost_of_transport(t.metrics[t.success], t.mass),
    ),
    Metric(
        "cost_of_transport_positive",
        "CoT +",
        "",
        3,
        reduce=lambda t: cost_of_transport(t.metrics, t.mass, "positive_work"),
    ),
    # Variance over the time of a trial of the root's rate about the vertical.
    Metric(
        "yaw_rate_variance",
        "σ²_yaw",
        "rad²/s²",
        4,
        lambda s: s.yaw_rate,
        "variance",
        recorded_average("yaw_rate_variance"),
        interval=True,
        paper="yaw_rate_variance",
    ),
    # Heights above the ground right below: mean of the trials' means.
    Metric(
        "com_height",
        "h_com",
        "m",
        3,
        lambda s: s.com_height,
        reduce=recorded_average("com_height"),
        interval=True,
        paper="com_height",
    ),
    Metric(
        "root_height",
        "h_root",
        "m",
        3,
        lambda s: s.root_height,
        reduce=recorded_average("root_height"),
        interval=True,
    ),
    # Largest |torque| of either knee in a trial, averaged over trials; and the largest of all trials.
    Metric(
        "knee_peak",
        "τ_knee",
        "Nm",
        1,
        lambda s: s.knee_torque.amax(dim=1),
        "max",
        recorded_average("knee_peak"),
        interval=True,
        paper="knee_peak",
    ),
    Metric("knee_max", "τ max", "Nm", 1, reduce=lambda t: largest(t.recorded("knee_peak"))),
    Metric("knee_p99", "τ p99", "Nm", 1, reduce=lambda t: knee_quantile(t.metrics, 0.99)),
    # Share of time in which two parts of the robot press on each other: mean of the trials' shares.
    Metric(
        "self_contact",
        "self-contact",
        "%",
        1,
        lambda s: 100.0 * (s.self_force > CONTACT_FORCE),
        reduce=recorded_average("self_contact"),
        interval=True,
    ),
)

RECORDED = tuple(metric for metric in METRICS if metric.sample is not None)
"""Metrics that the recorder samples."""
REPORTED = {metric.name: metric for metric in METRICS if metric.reduce is not None}
"""Metrics that results and tables show, by name."""

EACH: dict[str, Callable[[TrialSet], Array]] = {
    "success": lambda t: t.success.astype(np.float64),
    "max_distance": lambda t: t.max_place,
    "traversal_s": lambda t: np.where(t.success, t.seconds, np.nan),
    "speed": lambda t: t.recorded("speed"),
    "speed_error": lambda t: np.abs(t.recorded("speed") - t.commanded),
    "yaw_rate_variance": lambda t: t.recorded("yaw_rate_variance"),
    "com_height": lambda t: t.recorded("com_height"),
    "root_height": lambda t: t.recorded("root_height"),
    "knee_peak": lambda t: t.recorded("knee_peak"),
    "self_contact": lambda t: t.recorded("self_contact"),
    # Cost of transport is the quotient of the sums of these two.
    "weight_work": lambda t: t.recorded("work") / (t.mass * GRAVITY),
    "distance": lambda t: t.metrics.distance,
}
"""Values of single trials [T] that results keep, NaN where nothing was measured: what an interval over seeds and trials
is made from. Their means, or quotients of sums, are the figures of the same names."""

PROFILE: dict[str, Callable[[StepSample], Tensor]] = {
    "hip_torque": lambda s: s.group_torque[:, 0],
    "knee_flexion": lambda s: s.knee_flexion,
    "com_height": lambda s: s.com_height,
    "torso_pitch": lambda s: s.torso_pitch,
}
"""Samples [M] that are averaged by place along the track: Nm of one hip, rad, m, rad."""
