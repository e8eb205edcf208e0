"""What happens in trials: one walk in each world, recorded on the device until it ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from humoslope.evaluation.common import to_host
from humoslope.statistics import Array, mean


@dataclass(frozen=True)
class Trials:
    """N trials on the host. Averages are over the time walked after settling; NaN where there was none.

    Attributes:
        fell: [N] bool; ended in failure (a diverged world counts as one).
        left: [N] bool; ended before its time without failure: walked off the tile.
        seconds: [N] until the end, s.
        start, end: [N] first and last place along the tile, m.
        samples: [N] control steps that the averages are over.
        speed: [N] mean forward speed along the ground, m/s.
        squared_error: [N] summed squared difference of that speed from the commanded one, (m/s)^2.
        height: [N] mean height of the root above the ground, m.
    """

    fell: np.ndarray
    left: np.ndarray
    seconds: Array
    start: Array
    end: Array
    samples: Array
    speed: Array
    squared_error: Array
    height: Array

    def __len__(self) -> int:
        return len(self.fell)

    def __getitem__(self, which: slice) -> Trials:
        return Trials(**{name: value[which] for name, value in vars(self).items()})

    def speed_error(self, commanded: float) -> float | None:
        """How far a trial's mean speed is from the commanded one, averaged over trials, m/s."""
        return mean(np.abs(self.speed - commanded))

    @property
    def rms_speed_error(self) -> float | None:
        """Root mean square difference of the speed at each instant from the commanded one, over all trials, m/s."""
        samples = self.samples.sum()
        return float(np.sqrt(self.squared_error.sum() / samples)) if samples else None


class Recorder:
    """Gathers trials step by step; a world that has ended is ignored from then on. Nothing waits for the device.

    Args:
        place: [N] where the worlds start along their tile, m.
        commanded: Commanded speed, m/s.
        settle_steps: Control steps before speed and height count.
        dt: Control step, s.
    """

    def __init__(self, place: Tensor, commanded: float, settle_steps: int, dt: float) -> None:
        self._commanded, self._settle, self._dt = commanded, settle_steps, dt
        self._start = self._end = place.clone()
        self._running = torch.ones_like(place, dtype=torch.bool)
        self._fell, self._left = torch.zeros_like(self._running), torch.zeros_like(self._running)
        self._steps = torch.zeros_like(place)
        # Sums are double: a thousand steps of single precision would show in the fourth digit.
        self._samples = torch.zeros_like(place, dtype=torch.float64)
        self._speed, self._error, self._height = (torch.zeros_like(self._samples) for _ in range(3))
        self._step = 0

    def add(self, place: Tensor, speed: Tensor, height: Tensor, failed: Tensor, ended: Tensor) -> None:
        """Takes the outcome of one control step, all [N].

        The other values of a world that has just ended belong to its next episode and are not used.

        Args:
            place: Along the tile, m.
            speed: Forward along the ground, m/s.
            height: Root above the ground, m.
            failed: Whether the episode ended in failure.
            ended: Whether it ended otherwise.
        """
        self._step += 1
        self._steps = self._steps + self._running
        self._fell = self._fell | (self._running & failed)
        self._left = self._left | (self._running & ended & ~failed)
        self._running = self._running & ~failed & ~ended
        self._end = torch.where(self._running, place, self._end)
        if self._step <= self._settle:
            return
        self._samples = self._samples + self._running
        self._speed = self._speed + torch.where(self._running, speed, 0.0)
        self._error = self._error + torch.where(self._running, (speed - self._commanded).square(), 0.0)
        self._height = self._height + torch.where(self._running, height, 0.0)

    def trials(self) -> Trials:
        """What was gathered. Waits for the device."""
        samples = self._samples.masked_fill(self._samples == 0, torch.nan)
        return Trials(
            fell=self._fell.cpu().numpy(),
            left=self._left.cpu().numpy(),
            seconds=to_host(self._steps * self._dt),
            start=to_host(self._start),
            end=to_host(self._end),
            samples=to_host(self._samples),
            speed=to_host(self._speed / samples),
            squared_error=to_host(self._error),
            height=to_host(self._height / samples),
        )
