"""Recording of trials on a track, control step by control step.

Everything is accumulated on the device. Envs are given new trials while others are still running, so sums are kept by
trial and not by env. `metrics` defines what is recorded, `summary` turns the record into figures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from humoslope.evaluation.common import to_host
from humoslope.evaluation.track.arrays import map_arrays
from humoslope.evaluation.track.metrics import BIN, GROUPS, PROFILE, RECORDED, SETTLE_S, TORQUE_BIN
from humoslope.mdp.selection import joint_mask
from humoslope.scene.robot import Robot
from humoslope.slope import quaternion
from humoslope.statistics import Array, Bools

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


class LegJoints:
    """The joints of `GROUPS` in a robot.

    Attributes:
        members: [J, groups] 1 where a joint belongs to a group, else 0.
        mean: [J, groups] weights that average over the joints of a group.
        knees: [K] int64 indices of the knees.

    Raises:
        UserError: If a group matches no joint.
    """

    def __init__(self, robot: Robot, device: torch.device) -> None:
        self.members = torch.stack([joint_mask(robot, pattern, device) for pattern in GROUPS.values()], dim=1)
        self.mean = self.members / self.members.sum(dim=0)
        knee = list(GROUPS).index("knee")
        self.knees = self.members[:, knee].nonzero()[:, 0]


@dataclass
class StepSample:
    """State of M envs at one control step.

    Attributes:
        place: [M] root along the track, m from its start.
        segment: [M] int64 index of the segment there.
        speed: [M] forward speed of the root along the ground, m/s.
        commanded: [M] commanded forward speed, m/s.
        yaw_rate: [M] rate of the root about the vertical, rad/s.
        com_height: [M] centre of mass above the ground right below it, m.
        root_height: [M] root above the ground below it, m.
        torso_pitch: [M] lean of the torso in the heading direction, rad, positive forward.
        self_force: [M] largest force between two parts of the robot, N.
        joint_pos, joint_vel, joint_torque: [M, J] rad, rad/s, Nm.
        legs: Groups of the joints.
    """

    place: Tensor
    segment: Tensor
    speed: Tensor
    commanded: Tensor
    yaw_rate: Tensor
    com_height: Tensor
    root_height: Tensor
    torso_pitch: Tensor
    self_force: Tensor
    joint_pos: Tensor
    joint_vel: Tensor
    joint_torque: Tensor
    legs: LegJoints

    @classmethod
    def read(cls, env: Env, legs: LegJoints, place: Tensor, segment: Tensor) -> StepSample:
        """Sample of all envs at the present instant, at these places [N] and segments [N]."""
        s = env.signals
        up = torch.zeros_like(s.root_pos_w)
        up[:, 2] = 1.0
        torso_up_w = quaternion.rotate(s.torso_quat_w, up)
        forward = s.heading_w.cos() * torso_up_w[:, 0] + s.heading_w.sin() * torso_up_w[:, 1]
        return cls(
            place=place,
            segment=segment,
            speed=s.root_lin_vel_t[:, 0],
            commanded=env.commands.velocity[:, 0],
            yaw_rate=-(s.projected_gravity_b * s.root_ang_vel_b).sum(dim=1),
            com_height=s.com_height,
            root_height=s.root_height,
            torso_pitch=torch.atan2(forward, torso_up_w[:, 2]),
            self_force=s.self_force,
            joint_pos=s.joint_pos,
            joint_vel=s.joint_vel,
            joint_torque=s.joint_torque,
            legs=legs,
        )

    @cached_property
    def power(self) -> Tensor:
        """[M, J] mechanical power of each joint, W."""
        return self.joint_torque * self.joint_vel

    @cached_property
    def driving_power(self) -> Tensor:
        """[M, J] power where the joint drives, else 0, W."""
        return self.power.clamp(min=0.0)

    @cached_property
    def group_torque(self) -> Tensor:
        """[M, groups] mean |torque| of a joint of each of `GROUPS`, Nm."""
        return self.joint_torque.abs() @ self.legs.mean

    @cached_property
    def knee_torque(self) -> Tensor:
        """[M, K] |torque| of each knee, Nm."""
        return self.joint_torque.abs().index_select(1, self.legs.knees)

    @cached_property
    def knee_flexion(self) -> Tensor:
        """[M] mean flexion of both knees, rad."""
        return self.joint_pos @ self.legs.mean[:, 1]


@dataclass(frozen=True)
class TrackTrials:
    """Record of T trials on the host.

    Attributes:
        values: Values [T] of the recorded metrics by name. Means and variances are NaN where a trial ended before it
            had settled, maxima where it has no sample.
        samples: [T] control steps after settling.
        distance: [T] from the first sample's place to the last one's, m; NaN for a trial without any.
        knee_histogram: [T, bins] int32; control steps, counted for each knee, with |torque| in each `TORQUE_BIN`.
        segment_samples: [T, segments] control steps after settling.
        segment_pitch, segment_flexion: [T, segments] torso pitch and mean flexion of both knees, summed over them, rad.
        segment_torque: [T, segments, groups] |torque| of a joint of each of `GROUPS`, summed over them, Nm.
        segment_positive, segment_negative: [T, segments, groups] work of each group's joints where it is positive, and
            where it is negative (as a positive number), J.
        profile_samples: [T, bins] control steps after settling in each `BIN` of place.
        profile: [T, bins, PROFILE] values of `PROFILE` summed over them.
    """

    values: dict[str, Array]
    samples: Array
    distance: Array
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

    def __getitem__(self, which: slice | Bools | NDArray[np.int64]) -> TrackTrials:
        """The trials selected by a slice, a mask or indices."""
        return map_arrays(lambda values: values[which], self)


class TrackRecorder:
    """Accumulates T trials step by step, without waiting for the device.

    Args:
        num_trials: T.
        num_segments: Segments of the track.
        dt: Control step, s.
        robot: Robot whose joints the samples hold.
        length: Length of the track, m.
        device: Device of the samples.
    """

    def __init__(
        self, num_trials: int, num_segments: int, dt: float, *, robot: Robot, length: float, device: torch.device
    ) -> None:
        self._trials, self._segments, self._dt = num_trials, num_segments, dt
        self._settle = round(SETTLE_S / dt)
        self.legs = LegJoints(robot, device)
        limit = max(robot.effort_limit[i] for i in self.legs.knees.tolist())
        self._torque_bins = math.ceil(limit / TORQUE_BIN) + 1
        self._place_bins = math.ceil(length / BIN - 1e-9)

        # One row more than there are trials takes the samples of envs without a running trial.
        rows = num_trials + 1

        def table(*shape: int) -> Tensor:
            # Double: a thousand steps of single precision would show in the fourth digit.
            return torch.zeros(*shape, dtype=torch.float64, device=device)

        self._integrals = [m for m in RECORDED if m.combine == "integral"]
        self._settled = [m for m in RECORDED if m.combine in ("mean", "variance", "sum")]
        self._squared = [m for m in RECORDED if m.combine == "variance"]
        self._peaked = [m for m in RECORDED if m.combine == "max"]
        self._steps = torch.zeros(rows, dtype=torch.int64, device=device)
        self._first, self._last = table(rows) + torch.nan, table(rows) + torch.nan
        self._energy = table(rows, len(self._integrals))
        self._sums = table(rows, 1 + len(self._settled) + len(self._squared))
        self._peaks = torch.full((rows, len(self._peaked)), -torch.inf, device=device)
        self._histogram = torch.zeros(rows * self._torque_bins, dtype=torch.int32, device=device)
        self._by_segment = table(rows * num_segments, 3 + 3 * len(GROUPS))
        self._by_place = table(rows * self._place_bins, 1 + len(PROFILE))

    def add(self, trial: Tensor, sample: StepSample, running: Tensor) -> None:
        """Adds one control step.

        Args:
            trial: [M] int64 index of the trial of each env; no two running envs have the same.
            sample: Their states.
            running: [M] bool; an env that is not running is ignored, whatever its state.
        """
        row = torch.where(running, trial, self._trials)
        place = sample.place.double()
        first = self._first[row]
        self._first[row] = torch.where(first.isnan(), place, first)
        self._last[row] = place
        steps = self._steps[row]
        self._steps[row] = steps + 1
        settled = (steps >= self._settle).to(torch.float64)[:, None]  # [M, 1]

        values = {m.name: m.sample(sample) for m in RECORDED if m.sample is not None}
        one = torch.ones_like(sample.speed)
        averaged = [one, *(values[m.name] for m in self._settled), *(values[m.name].square() for m in self._squared)]
        self._sums.index_add_(0, row, torch.stack(averaged, dim=1) * settled)
        # The distance is that between samples, and so is the work.
        between = torch.where(steps > 0, self._dt, 0.0)[:, None]
        energy = torch.stack([values[m.name] for m in self._integrals], dim=1) * between
        self._energy.index_add_(0, row, energy.double())
        peaks = torch.stack([values[m.name] for m in self._peaked], dim=1)
        self._peaks.scatter_reduce_(0, row[:, None].expand_as(peaks), peaks, "amax")

        bin_of_torque = (sample.knee_torque / TORQUE_BIN).to(torch.int64).clamp(0, self._torque_bins - 1)
        cell = (row[:, None] * self._torque_bins + bin_of_torque).flatten()
        self._histogram.index_add_(0, cell, torch.ones_like(cell, dtype=torch.int32))

        driving, members = sample.driving_power, self.legs.members
        work = [driving @ members * self._dt, (driving - sample.power) @ members * self._dt]
        posture = torch.stack([one, sample.torso_pitch, sample.knee_flexion], dim=1)
        there = torch.cat([posture, sample.group_torque, *work], dim=1)
        self._by_segment.index_add_(0, row * self._segments + sample.segment, there * settled)

        bin_ = (sample.place / BIN).to(torch.int64).clamp(0, self._place_bins - 1)
        along = torch.stack([one, *(take(sample) for take in PROFILE.values())], dim=1)
        self._by_place.index_add_(0, row * self._place_bins + bin_, along * settled)

    def trials(self) -> TrackTrials:
        """The record so far. Waits for the device."""
        count = self._trials
        sums = to_host(self._sums[:count])
        samples, sums = sums[:, 0], sums[:, 1:]
        settled = np.where(samples > 0.0, samples, np.nan)
        squares = dict(zip((m.name for m in self._squared), sums[:, len(self._settled) :].T, strict=True))
        values = dict(zip((m.name for m in self._integrals), to_host(self._energy[:count]).T, strict=True))
        peaks = to_host(self._peaks[:count])
        values |= zip((m.name for m in self._peaked), np.where(np.isneginf(peaks), np.nan, peaks).T, strict=True)
        for metric, total in zip(self._settled, sums.T, strict=False):
            mean = total / settled
            if metric.combine == "variance":
                values[metric.name] = np.maximum(squares[metric.name] / settled - mean**2, 0.0)
            else:
                values[metric.name] = total if metric.combine == "sum" else mean
        segments = to_host(self._by_segment).reshape(count + 1, self._segments, -1)[:count]
        torque, positive, negative = np.split(segments[:, :, 3:], 3, axis=2)
        places = to_host(self._by_place).reshape(count + 1, self._place_bins, -1)[:count]
        return TrackTrials(
            values=values,
            samples=samples,
            distance=to_host(self._last - self._first)[:count],
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
