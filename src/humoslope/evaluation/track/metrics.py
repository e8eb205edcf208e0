"""What is measured of a walk along a track, control step by control step, trial by trial.

Everything is gathered on the device: worlds are given new trials while others still walk, so sums are kept by trial and
not by world. What the figures of a table are made of is in `TrackTrials`; how they are made of it, in `summary`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from humoslope.mdp.selection import joint_mask
from humoslope.scene.robot import Robot
from humoslope.slope import quaternion
from humoslope.statistics import Array

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

SETTLE_S = 1.0
"""Time before averages over time begin, s: the robot starts from rest. Energy and peaks count from the start."""
BIN = 0.5
"""Extent of a bin of place, m, for what is drawn along the track."""
TORQUE_BIN = 1.0
"""Resolution of quantiles of the knee torque, Nm."""
GROUPS = ("hip", "knee", "ankle")
PROFILE = ("hip_torque", "knee_flexion", "com_height", "torso_pitch")
"""What is kept along the track."""


@dataclass(frozen=True)
class JointGroups:
    """The joints that bend a leg in the plane of walking, by regular expressions on whole names, both legs in each.

    Bending a knee is positive.
    """

    hip: str = ".*hip_pitch.*"
    knee: str = ".*knee.*"
    ankle: str = ".*ankle_pitch.*"


@dataclass
class StepSample:
    """What one control step shows, of M worlds.

    Attributes:
        place: [M] along the track, m from its start.
        segment: [M] int64 index of the segment there.
        speed: [M] of the root forward along the ground, m/s.
        yaw_rate: [M] of the root about the vertical, rad/s.
        com_height: [M] centre of mass above the ground right below it, m.
        root_height: [M] root above the ground below it, m.
        torso_pitch: [M] lean of the torso in the heading direction, rad, positive forward.
        joint_pos, joint_vel, joint_torque: [M, J] rad, rad/s, Nm.
    """

    place: Tensor
    segment: Tensor
    speed: Tensor
    yaw_rate: Tensor
    com_height: Tensor
    root_height: Tensor
    torso_pitch: Tensor
    joint_pos: Tensor
    joint_vel: Tensor
    joint_torque: Tensor

    @classmethod
    def read(cls, env: Env, place: Tensor, segment: Tensor) -> StepSample:
        """The sample of all worlds at the present instant, at these places [N] and segments [N]."""
        s = env.signals
        up = torch.zeros_like(s.root_pos_w)
        up[:, 2] = 1.0
        torso_up_w = quaternion.rotate(s.torso_quat_w, up)
        forward = s.heading_w.cos() * torso_up_w[:, 0] + s.heading_w.sin() * torso_up_w[:, 1]
        return cls(
            place=place,
            segment=segment,
            speed=s.root_lin_vel_t[:, 0],
            yaw_rate=-(s.projected_gravity_b * s.root_ang_vel_b).sum(dim=1),
            com_height=s.com_pos_w[:, 2] - env.terrain.height(s.com_pos_w[:, :2]),
            root_height=s.root_height,
            torso_pitch=torch.atan2(forward, torso_up_w[:, 2]),
            joint_pos=s.joint_pos,
            joint_vel=s.joint_vel,
            joint_torque=s.joint_torque,
        )


@dataclass(frozen=True)
class TrackTrials:
    """T trials on the host. Averages over time are NaN where a trial ended before it had settled.

    Attributes:
        samples: [T] control steps after settling.
        distance: [T] from the first sample's place to the last one's, m; NaN for a trial without any.
        work: [T] sum over joints and the time between these samples of |torque x velocity|, J.
        positive_work: [T] the same of torque x velocity where it is positive, J.
        speed: [T] mean forward speed along the ground, m/s.
        squared_error: [T] summed squared difference of that speed from the commanded one, (m/s)^2.
        yaw_rate_variance: [T] of the yaw rate over the time after settling, (rad/s)^2.
        com_height, root_height: [T] mean heights above the ground below, m.
        knee_peak: [T] largest |torque| of either knee at any control step, Nm.
        knee_histogram: [T, bins] int32; control steps, counted for each knee, with |torque| in each `TORQUE_BIN`.
        segment_samples: [T, segments] control steps after settling.
        segment_pitch, segment_flexion: [T, segments] torso pitch and mean flexion of both knees, summed over them, rad.
        segment_torque: [T, segments, groups] |torque| of a joint of each of `GROUPS`, summed over them, Nm.
        segment_positive, segment_negative: [T, segments, groups] work of each group's joints where it is positive, and
            where it is negative (as a positive number), J.
        profile_samples: [T, bins] control steps after settling in each `BIN` of place.
        profile: [T, bins, PROFILE] values summed over them; Nm of one hip, rad, m, rad.
    """

    samples: Array
    distance: Array
    work: Array
    positive_work: Array
    speed: Array
    squared_error: Array
    yaw_rate_variance: Array
    com_height: Array
    root_height: Array
    knee_peak: Array
    knee_histogram: NDArray[np.int32]
    segment_samples: Array
    segment_pitch: Array
    segment_flexion: Array
    segment_torque: Array
    segment_positive: Array
    segment_negative: Array
    profile_samples: Array
    profile: Array

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, which: slice | NDArray[Any]) -> TrackTrials:
        """The trials chosen by a slice, a mask or numbers."""
        return TrackTrials(**{name: value[which] for name, value in self.arrays().items()})

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All arrays by name, as `numpy.savez` takes them; `TrackTrials(**arrays)` gives the trials back."""
        return dict(vars(self))

    @staticmethod
    def join(parts: Sequence[TrackTrials]) -> TrackTrials:
        """All trials of the parts, in their order."""
        names = [field.name for field in dataclasses.fields(TrackTrials)]
        return TrackTrials(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})

    @staticmethod
    def load(arrays: Mapping[str, NDArray[Any]]) -> TrackTrials:
        """The trials out of a mapping that may hold other arrays too, such as an open npz file."""
        return TrackTrials(**{field.name: arrays[field.name] for field in dataclasses.fields(TrackTrials)})


TRIAL_SUMS = ("work", "positive_work", "samples", "speed", "squared_error", "yaw", "yaw_squared", "com", "root")
"""Columns of the sums by trial; the first two count from the start, the others once settled."""


class TrackRecorder:
    """Gathers T trials step by step; nothing waits for the device.

    Args:
        num_trials: T.
        num_segments: Segments of the track.
        dt: Control step, s.
        robot: Whose joints the samples hold.
        length: Of the track, m.
        commanded: Commanded speed, m/s.
        device: Where the samples are.
        joints: Which joints are hips, knees and ankles.
    """

    def __init__(
        self,
        num_trials: int,
        num_segments: int,
        dt: float,
        *,
        robot: Robot,
        length: float,
        commanded: float,
        device: torch.device,
        joints: JointGroups | None = None,
    ) -> None:
        self._trials, self._segments, self._dt = num_trials, num_segments, dt
        self._settle = round(SETTLE_S / dt)
        self._commanded = commanded
        joints = joints or JointGroups()
        self._members = torch.stack([joint_mask(robot, getattr(joints, g), device) for g in GROUPS], dim=1)  # [J, 3]
        self._mean = self._members / self._members.sum(dim=0)  # of one joint of each group
        knees = [i for i, is_knee in enumerate(self._members[:, 1].tolist()) if is_knee]
        self._knees = torch.tensor(knees, device=device)
        self._torque_bins = math.ceil(max(robot.effort_limit[i] for i in knees) / TORQUE_BIN) + 1
        self._place_bins = math.ceil(length / BIN - 1e-9)

        # One trial more than there are takes what worlds without a running trial show.
        rows = num_trials + 1

        def table(*shape: int) -> Tensor:
            # Double: a thousand steps of single precision would show in the fourth digit.
            return torch.zeros(*shape, dtype=torch.float64, device=device)

        self._steps = torch.zeros(rows, dtype=torch.int64, device=device)
        self._first, self._last = table(rows) + torch.nan, table(rows) + torch.nan
        self._sums = table(rows, len(TRIAL_SUMS))
        self._peak = torch.zeros(rows, device=device)
        self._histogram = torch.zeros(rows * self._torque_bins, dtype=torch.int32, device=device)
        self._by_segment = table(rows * num_segments, 3 + 3 * len(GROUPS))
        self._by_place = table(rows * self._place_bins, 1 + len(PROFILE))

    def add(self, trial: Tensor, sample: StepSample, running: Tensor) -> None:
        """Takes one control step.

        Args:
            trial: [M] int64 number of the trial that each world walks; no two running worlds walk the same.
            sample: What they show.
            running: [M] bool; a world that is not running is ignored, whatever it shows.
        """
        row = torch.where(running, trial, self._trials)
        place = sample.place.double()
        first = self._first[row]
        self._first[row] = torch.where(first.isnan(), place, first)
        self._last[row] = place
        steps = self._steps[row]
        self._steps[row] = steps + 1
        settled = (steps >= self._settle).to(torch.float64)[:, None]  # [M, 1]

        power = sample.joint_torque * sample.joint_vel  # [M, J] W
        driving = power.clamp(min=0.0)
        torque = sample.joint_torque.abs()
        # The distance is that between samples, and so is the work.
        between = torch.where(steps > 0, self._dt, 0.0)[:, None]
        energy = torch.stack([power.abs().sum(dim=1), driving.sum(dim=1)], dim=1) * between
        error, yaw = (sample.speed - self._commanded).square(), sample.yaw_rate
        one = torch.ones_like(yaw)
        over_time = [one, sample.speed, error, yaw, yaw.square(), sample.com_height, sample.root_height]
        self._sums.index_add_(0, row, torch.cat([energy, torch.stack(over_time, dim=1) * settled], dim=1))

        knee = torque.index_select(1, self._knees)  # [M, knees]
        self._peak.scatter_reduce_(0, row, knee.amax(dim=1), "amax")
        place_in_histogram = (knee / TORQUE_BIN).to(torch.int64).clamp(0, self._torque_bins - 1)
        cell = (row[:, None] * self._torque_bins + place_in_histogram).flatten()
        self._histogram.index_add_(0, cell, torch.ones_like(cell, dtype=torch.int32))

        flexion = sample.joint_pos @ self._mean[:, 1]
        of_groups = [torque @ self._mean]
        of_groups += [driving @ self._members * self._dt, (driving - power) @ self._members * self._dt]
        there = torch.cat([torch.stack([one, sample.torso_pitch, flexion], dim=1), *of_groups], dim=1)
        self._by_segment.index_add_(0, row * self._segments + sample.segment, there * settled)

        bin_ = (sample.place / BIN).to(torch.int64).clamp(0, self._place_bins - 1)
        along = torch.stack([one, of_groups[0][:, 0], flexion, sample.com_height, sample.torso_pitch], dim=1)
        self._by_place.index_add_(0, row * self._place_bins + bin_, along * settled)

    def trials(self) -> TrackTrials:
        """What was gathered. Waits for the device."""
        count = self._trials
        sums = dict(zip(TRIAL_SUMS, _host(self._sums[:count]).T, strict=True))
        settled = np.where(sums["samples"] > 0.0, sums["samples"], np.nan)
        yaw = sums["yaw"] / settled
        segments = _host(self._by_segment).reshape(count + 1, self._segments, -1)[:count]
        torque, positive, negative = np.split(segments[:, :, 3:], 3, axis=2)
        places = _host(self._by_place).reshape(count + 1, self._place_bins, -1)[:count]
        return TrackTrials(
            samples=sums["samples"],
            distance=_host(self._last - self._first)[:count],
            work=sums["work"],
            positive_work=sums["positive_work"],
            speed=sums["speed"] / settled,
            squared_error=sums["squared_error"],
            yaw_rate_variance=np.maximum(sums["yaw_squared"] / settled - yaw**2, 0.0),
            com_height=sums["com"] / settled,
            root_height=sums["root"] / settled,
            knee_peak=_host(self._peak[:count]),
            knee_histogram=self._histogram.view(count + 1, -1)[:count].cpu().numpy(),
            segment_samples=segments[:, :, 0],
            segment_pitch=segments[:, :, 1],
            segment_flexion=segments[:, :, 2],
            segment_torque=torque,
            segment_positive=positive,
            segment_negative=negative,
            profile_samples=places[:, :, 0],
            profile=places[:, :, 1:],
        )


def _host(values: Tensor) -> Array:
    return values.cpu().numpy().astype(np.float64)
