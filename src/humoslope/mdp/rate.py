"""Finite differences over control steps."""

from __future__ import annotations

import torch
from torch import Tensor


class RateOfChange:
    """Derivative of a signal [N, ...] by difference over one control step, zero in the first step after a reset.

    A reset teleports the robot; without the mask the first difference would be an impact that never happened.
    """

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._last: Tensor | None = None
        self._fresh: Tensor | None = None  # [N] bool

    def __call__(self, value: Tensor) -> Tensor:
        """Returns the derivative, in the shape of `value`."""
        if self._last is None:
            rate = torch.zeros_like(value)
        else:
            rate = (value - self._last) / self._dt
            if self._fresh is not None:
                rate = rate.masked_fill(self._fresh.view(-1, *[1] * (value.dim() - 1)), 0.0)
        self._last, self._fresh = value, None
        return rate

    def reset(self, mask: Tensor) -> None:
        """Makes the next difference of the envs in `mask` [N] zero."""
        self._fresh = mask if self._fresh is None else self._fresh | mask
