"""Memory of the gait rewards: progress, work of the stance legs, time in the air, swing."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import torch
from torch import Tensor

from humoslope.errors import UserError
from humoslope.managers.terms import StatefulTerm
from humoslope.mdp.selection import joint_pair
from humoslope.ranges import Positive
from humoslope.slope import bsga

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

MEMORY = 0.5
"""Time constant of moving averages, s: a little more than a step, so that they do not follow single steps. Ours."""

SWING_FORCE = 5.0
"""Contact force below which a foot swings, N; the paper filters by contact force and gives no number. Ours."""

SWING_SETTLE = 0.1
"""Time after lift-off from which a swing counts, s; longer than any chatter of contacts. Ours."""

SWING_LONGEST = 0.6
"""Time after lift-off up to which a swing counts, s; one and a half steps. Ours."""


class SlopeGait(StatefulTerm):
    """Cue that all BSGA rewards share: slope intensity and progress.

    It is an observer, so that its parameters are set in one place, `observers.slope_gait`. The rewards find it by its
    name, and it is computed once a step, when the first of them asks.

    Args:
        full_slope: Slope of full intensity, rad.
        memory_s: Time constant of the moving averages of speed and work, s.

    Attributes:
        gain: Weight of a new sample in these averages.
    """

    def __init__(self, env: Env, full_slope: Positive = bsga.FULL_SLOPE, memory_s: Positive = MEMORY) -> None:
        self._full_slope = full_slope
        self.gain = 1.0 - math.exp(-env.step_dt / memory_s)
        self._velocity = env.zeros(2)  # [N, 2] m/s along the ground, forward and left
        self._seen: Tensor | None = None  # velocity of the step that the cue was computed for, new in every step

    def __call__(self, env: Env) -> None:
        self._compute(env)

    def progress(self, env: Env) -> Tensor:
        """Gate of every BSGA term: share of the commanded speed that is walked in its direction, [N] in [0, 1].

        The velocity along the ground is averaged, so that swaying on the spot is no progress. It is 0 in envs that are
        commanded to stand or to turn in place.
        """
        self._compute(env)
        return self._progress

    def rho(self, env: Env) -> Tensor:
        """Slope intensity rho_slope, [N] in [0, 1]."""
        self._compute(env)
        return self._rho

    def _compute(self, env: Env) -> None:
        velocity = env.signals.root_lin_vel_t
        if self._seen is velocity:
            return
        self._seen = velocity
        self._velocity = torch.lerp(self._velocity, velocity[:, :2], self.gain)
        self._progress = bsga.progress(self._velocity, env.commands.velocity[:, :2], bsga.LEAST_SPEED)
        self._rho = bsga.slope_intensity(env.height_scan.descriptor.slope, self._full_slope)

    def reset(self, mask: Tensor) -> None:
        """Clears the average of the envs in `mask`."""
        self._velocity = self._velocity.masked_fill(mask[:, None], 0.0)
        self._seen = None


def slope_gait(env: Env, name: str) -> SlopeGait:
    """Returns the cue that is configured as the observer called `name`.

    Raises:
        UserError: If there is no such observer, or it is no `SlopeGait`.
    """
    cue = env.observers[name]
    if not isinstance(cue, SlopeGait):
        raise UserError(f"observer '{name}' is not a SlopeGait, which BSGA rewards need.")
    return cue


class StanceWork:
    """Moving average of the power of hip, knee and ankle pitch in the legs that touch the ground, of one sign.

    A leg in the air neither propels nor brakes; counting it would reward waving it.
    """

    def __init__(self, env: Env, joints: tuple[str, str, str], done: Literal["positive", "negative"], gain: float):
        """Starts without work.

        Args:
            joints: Patterns of hip, knee and ankle pitch.
            done: Sign of the power that counts.
            gain: Weight of a new sample.
        """
        self._index = torch.cat([joint_pair(env.robot, pattern, env.device) for pattern in joints])  # [6]
        self._sign = 1.0 if done == "positive" else -1.0
        self._gain = gain
        self._least = bsga.LEAST_POWER * env.robot.total_mass  # W
        self._power = env.zeros(3)  # [N, 3] W

    def share(self, env: Env, joint: int) -> Tensor:
        """Share [N] of one of the three joints, by its place; to be called once per step."""
        signals = env.signals
        power = (signals.joint_vel * signals.joint_torque).index_select(1, self._index) * self._sign
        stance = (power.clamp(min=0.0).view(-1, 3, 2) * signals.foot_contact[:, None]).sum(dim=2)
        self._power = torch.lerp(self._power, stance, self._gain)
        return bsga.work_share(self._power[:, joint], self._power.sum(dim=1), self._least)

    def reset(self, mask: Tensor) -> None:
        """Clears the work of the envs in `mask`."""
        self._power = self._power.masked_fill(mask[:, None], 0.0)


class AirTime:
    """Control steps since each foot last carried at least `force` N, `steps` [N, 2]."""

    def __init__(self, env: Env, force: float) -> None:
        self._force = force
        self.steps = env.zeros(2)

    def step(self, env: Env) -> Tensor:
        """Advances by a step; returns the feet that carry, [N, 2] bool."""
        carries = env.signals.foot_force >= self._force
        self.steps = (self.steps + 1.0).masked_fill(carries, 0.0)
        return carries

    def reset(self, mask: Tensor) -> None:
        """Puts both feet of the envs in `mask` on the ground."""
        self.steps = self.steps.masked_fill(mask[:, None], 0.0)


class Swing:
    """Detection of swinging legs, for the swing reward and for the calibration of its target.

    A leg swings between `settle_s` and `longest_s` after its foot last carried, while the other foot carries: a foot
    that is held up, a jump and a fall are no swing.
    """

    def __init__(self, env: Env, force: float, settle_s: float, longest_s: float) -> None:
        self._air = AirTime(env, force)
        self._settle, self._longest = (round(seconds / env.step_dt) for seconds in (settle_s, longest_s))

    def step(self, env: Env) -> Tensor:
        """Advances by a step; returns the legs that swing, [N, 2] bool."""
        carries, steps = self._air.step(env), self._air.steps
        return (steps >= self._settle) & (steps <= self._longest) & carries.flip(1)

    def reset(self, mask: Tensor) -> None:
        """Puts both feet of the envs in `mask` on the ground."""
        self._air.reset(mask)
