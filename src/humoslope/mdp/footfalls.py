"""What the contacts of the feet say over time; for terms that reward or price steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


class Landings:
    """Feet that touch the ground and did not one step before; none in the first step of an episode."""

    def __init__(self, env: Env) -> None:
        self._before = torch.ones_like(env.signals.foot_contact)

    def __call__(self, env: Env) -> Tensor:
        """[N, 2] bool."""
        contact = env.signals.foot_contact
        landed, self._before = contact & ~self._before, contact
        return landed

    def reset(self, mask: Tensor) -> None:
        """Forgets the contacts of the envs in `mask`."""
        self._before = self._before | mask[:, None]


class TimeOnOneLeg:
    """Time since a foot last landed or lifted, the shorter one of the two feet; 0 unless exactly one foot is down."""

    def __init__(self, env: Env) -> None:
        self._contact = env.signals.foot_contact
        self._steps = env.zeros(2)  # [N, 2] control steps in which the foot has been down or up

    def __call__(self, env: Env) -> Tensor:
        """[N] s."""
        contact = env.signals.foot_contact
        self._steps = self._steps.masked_fill(contact != self._contact, 0.0) + 1.0
        self._contact = contact
        return self._steps.amin(dim=1) * env.step_dt * (contact[:, 0] != contact[:, 1])

    def reset(self, mask: Tensor) -> None:
        """Sets the times of the envs in `mask` to zero."""
        self._steps = self._steps.masked_fill(mask[:, None], 0.0)
