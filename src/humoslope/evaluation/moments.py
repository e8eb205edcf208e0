"""The last moments of every trial, kept on the device for `causes`; nothing waits for it."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from humoslope.evaluation.causes import SIGNALS, WINDOW_S
from humoslope.slope.zmp import GRAVITY

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

CARRYING = ".*(hip|knee|ankle|waist).*"
"""Joints whose torque or range can let a robot fall, as a regular expression; arms only swing. All joints of a robot
that has none of these."""
SOLE_SCALE = 0.12
"""Half the extent over which the ground's normal below a foot is taken, m: about half a sole. It follows the slope and
its ends, but not the grains of a rough surface, against which a foot can run."""

LastMoments = dict[str, NDArray[np.float16]]
"""`SIGNALS` [T, K] of T trials, in the order of time; NaN where nothing was recorded."""


class MomentReader:
    """Reads `SIGNALS` of all envs.

    Its environment's friction must have been set: it is read once.
    """

    def __init__(self, env: Env) -> None:
        robot, sim = env.robot, env.sim
        names = robot.joint_names
        carrying = [i for i, name in enumerate(names) if re.fullmatch(CARRYING, name)] or range(len(names))
        chosen = torch.tensor(list(carrying), device=env.device)
        limit = torch.as_tensor(robot.effort_limit, dtype=torch.float32, device=env.device)
        self._chosen, self._limit = chosen, limit[chosen]
        self._low, self._high = env.joint_range[chosen].unbind(dim=1)
        feet = [sim.model.geom(name).id for side in robot.foot_geoms for name in side]
        self._friction = sim.expand("geom_friction")[:, feet, 0].float().amin(dim=1)
        self._weight = GRAVITY * robot.total_mass

    def __call__(self, env: Env) -> Tensor:
        """The present moment, [N, S] in the order of `SIGNALS`."""
        s, ground = env.signals, env.terrain
        feet = s.foot_pos_w[:, :, :2]
        normal = ground.slope_normal(ground.height(ground.around(feet, SOLE_SCALE)), SOLE_SCALE)  # [N, 2, 3]
        load = (s.foot_force_w * normal).sum(dim=2)  # [N, 2] N
        drag = (s.foot_force_w - load[:, :, None] * normal).norm(dim=2)
        rising = (s.foot_lin_vel_w * normal).sum(dim=2)
        speed = (s.foot_lin_vel_w - rising[:, :, None] * normal).norm(dim=2)
        torque = s.joint_torque.index_select(1, self._chosen).abs()
        able = self._limit * env.drives.strength.index_select(1, self._chosen)
        place = s.joint_pos.index_select(1, self._chosen)
        alone = [
            torch.acos((-s.projected_gravity_b[:, 2]).clamp(-1.0, 1.0)),
            (torque / able).amax(dim=1),
            torch.minimum(place - self._low, self._high - place).amin(dim=1),
            s.shin_force.amax(dim=1) / self._weight,
            self._friction,
        ]
        return torch.cat([torch.stack(alone, dim=1), load / self._weight, drag / self._weight, speed], dim=1)


class MomentTable:
    """Keeps the last `WINDOW_S` of T trials, each in a ring of its own.

    Args:
        num_trials: T.
        dt: Control step, s.
        device: Device of the signals.
    """

    def __init__(self, num_trials: int, dt: float, device: torch.device) -> None:
        self.length = window_steps(dt)
        self._trials = num_trials
        # One row more than there are trials takes what envs without a running trial write.
        shape = (num_trials + 1, self.length, len(SIGNALS))
        self._table = torch.full(shape, torch.nan, dtype=torch.float16, device=device)
        self._steps = torch.zeros(num_trials + 1, dtype=torch.int64, device=device)

    def add(self, trial: Tensor, moment: Tensor, running: Tensor) -> None:
        """Adds one control step.

        Args:
            trial: [M] int64 index of the trial of each env; no two running envs have the same.
            moment: [M, S] what a `MomentReader` gives.
            running: [M] bool; an env that is not running is ignored.
        """
        row = torch.where(running, trial, self._trials)
        steps = self._steps[row]
        self._table[row, steps % self.length] = moment.to(torch.float16)
        self._steps[row] = steps + 1

    def moments(self, which: NDArray[np.bool_]) -> LastMoments:
        """The last moments of the trials in `which` [T], NaN for all others. Waits for the device."""
        table = self._table[: self._trials].cpu().numpy()
        steps = self._steps[: self._trials].cpu().numpy()
        slots = (steps[:, None] + np.arange(self.length)) % self.length  # the oldest first
        ordered = np.take_along_axis(table, slots[:, :, None], axis=1)
        ordered = np.where(which[:, None, None], ordered, np.float16(np.nan))
        return {name: np.ascontiguousarray(ordered[:, :, i]) for i, name in enumerate(SIGNALS)}


def window_steps(dt: float) -> int:
    """Control steps of `WINDOW_S`, at least two."""
    return max(2, round(WINDOW_S / dt))


def complete(moments: LastMoments, trials: int, steps: int) -> LastMoments:
    """`SIGNALS` [T, K] of T `trials` over K `steps`, NaN where `moments`, of an older file, lacks one of them."""
    nothing = np.full((trials, steps), np.nan, np.float16)
    kept = {name: moments.get(name, nothing) for name in SIGNALS}
    return kept if all(values.shape == nothing.shape for values in kept.values()) else dict.fromkeys(SIGNALS, nothing)
