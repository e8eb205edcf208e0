"""Frames of a sensor that is slower than the control loop, and late."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


class LateFrames:
    """The last frames of every env, of which one of some age is read.

    Attributes:
        lag: [N] int64; the frame that is read, in frames before the newest one.
    """

    def __init__(self, env: Env, size: int, most: int) -> None:
        """Args:
        size: Numbers in a frame.
        most: Largest lag.
        """
        self._frames = env.zeros(most + 1, size)  # [N, F, size], the newest first
        self.lag = env.zeros(dtype=torch.int64)

    def add(self, rows: Tensor | slice, frame: Tensor, new: Tensor, fresh: Tensor) -> None:
        """Adds a frame in some envs.

        Args:
            rows: Index of n envs (see `Simulation.known_rows`), which include those in `new`.
            frame: [n, size].
            new: [n] bool; the envs among them that get the frame.
            fresh: [n] bool; those of which all earlier frames become this one, as an episode begins.
        """
        before = self._frames[rows]
        after = torch.cat([frame[:, None], before[:, :-1]], dim=1)
        after = torch.where(fresh[:, None, None], frame[:, None], after)
        # In place: the buffer is the largest thing that this sensor keeps.
        self._frames[rows] = torch.where(new[:, None, None], after, before)

    def read(self) -> Tensor:
        """The frame at each env's lag, [N, size], a fresh tensor."""
        index = self.lag[:, None, None].expand(-1, 1, self._frames.shape[2])
        return self._frames.gather(1, index)[:, 0]
