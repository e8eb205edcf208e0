"""Record of the states before physics diverges."""

from __future__ import annotations

import torch
from torch import Tensor

STEPS = 10
"""Number of control steps that are kept."""


class DivergenceRecorder:
    """Ring buffer of the last states of all worlds, and a copy of those of the first world that diverged.
    Only `take` waits for the device.

    Args:
        qpos: [N, nq], for its size.
        qvel: [N, nv], for its size.
    """

    def __init__(self, qpos: Tensor, qvel: Tensor) -> None:
        self._nq = qpos.shape[1]
        size = self._nq + qvel.shape[1]
        self._ring = torch.zeros(STEPS, len(qpos), size, device=qpos.device)  # [K, N, nq + nv]
        self._steps = 0
        self._states = torch.zeros(STEPS, size, device=qpos.device)
        self._kept = torch.zeros((), dtype=torch.bool, device=qpos.device)

    def add(self, qpos: Tensor, qvel: Tensor) -> None:
        """Adds the states of a control step."""
        newest = self._ring[self._steps % STEPS]
        newest[:, : self._nq].copy_(qpos)
        newest[:, self._nq :].copy_(qvel)
        self._steps += 1

    def keep(self, diverged: Tensor) -> None:
        """Copies the last states of the first world in `diverged` [N], if any, unless there is a copy already."""
        first = diverged.to(torch.uint8).argmax(dim=0, keepdim=True)
        states = self._ring.index_select(1, first).squeeze(1).roll(-(self._steps % STEPS), 0)  # oldest first
        fresh = diverged.any() & ~self._kept
        self._states = torch.where(fresh, states, self._states)
        self._kept = self._kept | fresh

    def take(self) -> tuple[Tensor, Tensor] | None:
        """Returns qpos [K, nq] and qvel [K, nv] of the first world that diverged since the last call, or None.

        The oldest state comes first; steps before the first one are zero.
        """
        if not self._kept.item():
            return None
        self._kept = torch.zeros_like(self._kept)
        states = self._states.cpu()
        return states[:, : self._nq], states[:, self._nq :]
