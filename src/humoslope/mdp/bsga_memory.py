"""What the gait rewards remember of the last steps: progress, work of the stance legs, time in the air, swing."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import torch
from torch import Tensor

from humoslope.errors import require_positive
from humoslope.mdp.selection import joint_pair
from humoslope.slope import bsga

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

MEMORY = 0.5
"""Time constant of moving averages, s: a little more than a step, so that neither legs nor swaying show."""

SWING_FORCE = 5.0
"""A foot that presses less on the ground swings, N; the paper filters by contact force and gives no number. Ours."""

SWING_SETTLE = 0.1
"""A swing counts from this time after lift-off, s; longer than any chatter of contacts. Ours."""

SWING_LONGEST = 0.6
"""A swing counts no more from this time after lift-off, s; one and a half steps. Ours."""


class Progress:
    """The gate of every BSGA term: the share of the commanded forward speed that is walked, in [0, 1].

    The speed along the ground is averaged over `memory_s`: who sways on the spot walks nowhere. Worlds that are asked
    to stand, to step aside or to go backwards make no progress.
    """

    def __init__(self, env: Env, memory_s: float) -> None:
        self._gain = _gain(env, memory_s)
        self._speed = env.zeros()  # [N] m/s

    def __call__(self, env: Env) -> Tensor:
        """The gate [N]; to be called once per step."""
        self._speed = torch.lerp(self._speed, env.signals.root_lin_vel_t[:, 0], self._gain)
        return bsga.progress(self._speed, env.commands.velocity[:, 0], bsga.LEAST_SPEED)

    def reset(self, mask: Tensor) -> None:
        """An episode starts without progress."""
        self._speed = self._speed.masked_fill(mask, 0.0)


class StanceWork:
    """Moving average of the power of hip, knee and ankle pitch in the legs that touch the ground, of one sign.

    A leg in the air neither propels nor brakes; counting it would pay for waving it.
    """

    def __init__(self, env: Env, joints: tuple[str, str, str], done: Literal["positive", "negative"], memory_s: float):
        pairs = [joint_pair(env.robot, pattern) for pattern in joints]
        self._index = torch.tensor(pairs, device=env.device).flatten()  # [6]
        self._sign = 1.0 if done == "positive" else -1.0
        self._gain = _gain(env, memory_s)
        self._least = bsga.LEAST_POWER * env.robot.total_mass  # W
        self._power = env.zeros(3)  # [N, 3] W

    def share(self, env: Env, joint: int) -> Tensor:
        """Share [N] of the joint with this place among the three; to be called once per step."""
        signals = env.signals
        power = (signals.joint_vel * signals.joint_torque).index_select(1, self._index) * self._sign
        stance = (power.clamp(min=0.0).view(-1, 3, 2) * signals.foot_contact[:, None]).sum(dim=2)
        self._power = torch.lerp(self._power, stance, self._gain)
        return bsga.work_share(self._power[:, joint], self._power.sum(dim=1), self._least)

    def reset(self, mask: Tensor) -> None:
        """An episode starts without work."""
        self._power = self._power.masked_fill(mask[:, None], 0.0)


class AirTime:
    """Time since each foot last carried at least `force` N, [N, 2] s."""

    def __init__(self, env: Env, force: float) -> None:
        self._force = force
        self.time = env.zeros(2)

    def step(self, env: Env) -> Tensor:
        """Lets a step pass; which feet carry [N, 2]."""
        carries = env.signals.foot_force >= self._force
        self.time = (self.time + env.step_dt).masked_fill(carries, 0.0)
        return carries

    def reset(self, mask: Tensor) -> None:
        """An episode starts on both feet."""
        self.time = self.time.masked_fill(mask[:, None], 0.0)


class Swing:
    """Which legs swing, for the swing reward and for the calibration of its target.

    A leg swings between `settle_s` and `longest_s` after its foot last carried, while the other foot carries: a foot
    that is held up, a jump and a fall are no swing.
    """

    def __init__(self, env: Env, force: float, settle_s: float, longest_s: float) -> None:
        self._air = AirTime(env, force)
        self._settle, self._longest = settle_s, longest_s

    def step(self, env: Env) -> Tensor:
        """Lets a step pass; which legs swing [N, 2]."""
        carries, time = self._air.step(env), self._air.time
        return (time >= self._settle) & (time <= self._longest) & carries.flip(1)

    def reset(self, mask: Tensor) -> None:
        """An episode starts on both feet."""
        self._air.reset(mask)


def _gain(env: Env, memory_s: float) -> float:
    """Weight of a new sample in an exponential moving average with this time constant, s."""
    require_positive("moving average", memory_s=memory_s)
    return 1.0 - math.exp(-env.step_dt / memory_s)
