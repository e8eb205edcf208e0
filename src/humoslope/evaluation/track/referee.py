"""The rules of a trial: when it ends, and how."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from humoslope.evaluation.track.protocol import HeldOutProtocol

OUTCOMES = ("success", "fell", "left", "timed_out")
"""Ways in which a trial can end; if two happen at once, the first counts."""


class Situation(NamedTuple):
    """State of all envs at one instant, as far as the rules need it.

    Attributes:
        place: [N] root along the course, m.
        across: [N] root to the left of the centre line, m.
        com_height: [N] centre of mass above the ground below it, m.
        upright: [N] cosine of the root's lean from the vertical.
        upper_force: [N] ground force on everything but feet and shins, N.
        diverged: [N] bool; the physics of the env diverged.
        steps: [N] int64 control steps since the start of the trial.
    """

    place: Tensor
    across: Tensor
    com_height: Tensor
    upright: Tensor
    upper_force: Tensor
    diverged: Tensor
    steps: Tensor


class Referee:
    """Applies a protocol's rules, control step by control step.

    Args:
        half_width: Half the width of the course, m.
        dt: Control step, s.
    """

    def __init__(self, protocol: HeldOutProtocol, half_width: float, dt: float) -> None:
        self._protocol, self._half_width = protocol, half_width
        self._contact_steps = max(1, round(protocol.fall_contact_s / dt))
        self._least_upright = math.cos(math.radians(protocol.fall_tilt))
        self._timeout_steps = max(1, round(protocol.timeout_s / dt))
        self._touching: Tensor | None = None  # [N] control steps of uninterrupted contact

    def judge(self, now: Situation) -> Tensor:
        """Outcomes of the trials that end now, bool [N, 4] in the order of `OUTCOMES`; at most one holds in an env."""
        protocol = self._protocol
        touching = 0 if self._touching is None else self._touching
        self._touching = torch.where(now.upper_force > protocol.fall_force, touching + 1, torch.zeros_like(now.place))
        success = (now.place >= protocol.success_place) & ~now.diverged
        fell = (
            (self._touching >= self._contact_steps)
            | (now.upright < self._least_upright)
            | (now.com_height < protocol.fall_com_height)
            | now.diverged
        ) & ~success
        left = ((now.across.abs() > self._half_width) | (now.place < 0.0)) & ~(success | fell)
        timed_out = (now.steps >= self._timeout_steps) & ~(success | fell | left)
        return torch.stack([success, fell, left, timed_out], dim=1)

    def reset(self, mask: Tensor) -> None:
        """Forgets the contacts of the envs in `mask`."""
        if self._touching is not None:
            self._touching = self._touching.masked_fill(mask, 0.0)
