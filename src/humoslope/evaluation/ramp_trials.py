"""Recording of ramp trials: one episode in each env, accumulated on the device until it ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from humoslope.deploy.gait import SWING_S
from humoslope.evaluation.common import to_host
from humoslope.evaluation.track.arrays import map_arrays
from humoslope.statistics import Array, Bools, mean


@dataclass(frozen=True)
class Trials:
    """N trials on the host. Averages are over the time after settling; NaN where there was none.

    Attributes:
        fell: [N] bool; ended in failure (a diverged env counts as one).
        left: [N] bool; ended before its time without failure: walked off the tile.
        seconds: [N] duration, s.
        start, end: [N] first and last place along the tile, m.
        samples: [N] control steps that the averages are over.
        measured_s: [N] duration of these steps, s; NaN where there were none.
        speed: [N] mean forward speed along the ground, m/s.
        squared_error: [N] summed squared difference of that speed from the commanded one, (m/s)^2.
        lateral: [N] mean speed to the left along the ground, m/s.
        yaw_rate: [N] mean rate of the root about the vertical, rad/s.
        height: [N] mean height of the root above the ground, m.
        creep: [N, 2] mean |velocity| along the ground, forward and to the left, m/s.
        drift: [N, 2] horizontal displacement between settling and the last place, along and across the tile, m.
        touchdowns: [N] steps per second; see `humoslope.deploy.gait.STEP`.
        self_contact: [N] share of the time in which two parts of the robot press on each other.
    """

    fell: Bools
    left: Bools
    seconds: Array
    start: Array
    end: Array
    samples: Array
    measured_s: Array
    speed: Array
    squared_error: Array
    lateral: Array
    yaw_rate: Array
    height: Array
    creep: Array
    drift: Array
    touchdowns: Array
    self_contact: Array

    def __len__(self) -> int:
        return len(self.fell)

    def __getitem__(self, which: slice) -> Trials:
        return map_arrays(lambda values: values[which], self)

    def speed_error(self, commanded: float) -> float | None:
        """Difference of a trial's mean speed from the commanded one, averaged over trials, m/s."""
        return mean(np.abs(self.speed - commanded))

    @property
    def rms_speed_error(self) -> float | None:
        """Root mean square difference of the speed at each instant from the commanded one, over all trials, m/s."""
        samples = self.samples.sum()
        return float(np.sqrt(self.squared_error.sum() / samples)) if samples else None


class Recorder:
    """Accumulates trials step by step; an env whose trial has ended is ignored. Nothing waits for the device.

    Args:
        place: [N, 2] start along and across the tile, m.
        commanded: Commanded speed, m/s.
        settle_steps: Control steps before averages begin.
        dt: Control step, s.
    """

    def __init__(self, place: Tensor, commanded: float, settle_steps: int, dt: float) -> None:
        self._commanded, self._settle, self._dt = commanded, settle_steps, dt
        self._start = self._end = self._settled = place.clone()
        self._running = torch.ones_like(place[:, 0], dtype=torch.bool)
        self._fell, self._left = torch.zeros_like(self._running), torch.zeros_like(self._running)
        self._steps = torch.zeros_like(place[:, 0])
        self._air = torch.zeros_like(place)  # [N, 2] control steps that each foot has been in the air
        # Sums are double: a thousand steps of single precision would show in the fourth digit.
        self._samples = torch.zeros_like(self._steps, dtype=torch.float64)
        self._speed, self._lateral, self._yaw_rate = (torch.zeros_like(self._samples) for _ in range(3))
        self._error, self._height = torch.zeros_like(self._samples), torch.zeros_like(self._samples)
        self._landings, self._touching = torch.zeros_like(self._samples), torch.zeros_like(self._samples)
        self._creep = torch.zeros_like(place, dtype=torch.float64)
        self._step = 0

    def add(
        self,
        place: Tensor,
        velocity: Tensor,
        yaw_rate: Tensor,
        height: Tensor,
        contact: Tensor,
        self_contact: Tensor,
        failed: Tensor,
        ended: Tensor,
    ) -> None:
        """Adds one control step.

        An env that has just ended already shows its next episode, which is ignored.

        Args:
            place: [N, 2] along and across the tile, m.
            velocity: [N, 2] along the ground, forward and to the left, m/s.
            yaw_rate: [N] of the root about the vertical, rad/s.
            height: [N] root above the ground, m.
            contact: [N, 2] bool; feet that are down, see `humoslope.deploy.gait.FOOT_DOWN_N`.
            self_contact: [N] bool; two parts of the robot press on each other.
            failed: [N] bool; the episode ended in failure.
            ended: [N] bool; it ended otherwise.
        """
        self._step += 1
        self._steps = self._steps + self._running
        self._fell = self._fell | (self._running & failed)
        self._left = self._left | (self._running & ended & ~failed)
        self._running = self._running & ~failed & ~ended
        running = self._running[:, None]
        self._end = torch.where(running, place, self._end)
        landed = contact & (self._air * self._dt >= SWING_S - 0.5 * self._dt)
        self._air = (self._air + 1.0).masked_fill(contact, 0.0)
        if self._step <= self._settle:
            self._settled = self._end
            return
        self._samples = self._samples + self._running
        speed = velocity[:, 0]
        self._speed = self._speed + torch.where(self._running, speed, 0.0)
        self._lateral = self._lateral + torch.where(self._running, velocity[:, 1], 0.0)
        self._yaw_rate = self._yaw_rate + torch.where(self._running, yaw_rate, 0.0)
        self._error = self._error + torch.where(self._running, (speed - self._commanded).square(), 0.0)
        self._height = self._height + torch.where(self._running, height, 0.0)
        self._creep = self._creep + torch.where(running, velocity.abs(), 0.0)
        self._landings = self._landings + (landed & running).sum(dim=1)
        self._touching = self._touching + (self_contact & self._running)

    def trials(self) -> Trials:
        """The record so far. Waits for the device."""
        samples = self._samples.masked_fill(self._samples == 0, torch.nan)
        nothing = samples.isnan()[:, None]
        return Trials(
            fell=self._fell.cpu().numpy(),
            left=self._left.cpu().numpy(),
            seconds=to_host(self._steps * self._dt),
            start=to_host(self._start[:, 0]),
            end=to_host(self._end[:, 0]),
            samples=to_host(self._samples),
            measured_s=to_host(samples * self._dt),
            speed=to_host(self._speed / samples),
            squared_error=to_host(self._error),
            lateral=to_host(self._lateral / samples),
            yaw_rate=to_host(self._yaw_rate / samples),
            height=to_host(self._height / samples),
            creep=to_host(self._creep / samples[:, None]),
            drift=to_host((self._end - self._settled).double().masked_fill(nothing, torch.nan)),
            touchdowns=to_host(self._landings / (samples * self._dt)),
            self_contact=to_host(self._touching / samples),
        )
