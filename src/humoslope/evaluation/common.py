"""What every evaluation shares: its physics, and a policy that drives an environment while something watches."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import torch
from tensordict import TensorDict
from torch import Tensor

from humoslope.env import ManagerBasedRlEnv, SimCfg
from humoslope.errors import UserError


def roll(
    env: ManagerBasedRlEnv,
    policy: Callable[[TensorDict], Tensor],
    seconds: float,
    record: Callable[[Tensor, Tensor], None],
    on_step: Callable[[], None] = lambda: None,
) -> None:
    """Lets the policy drive all worlds for `seconds`.

    Args:
        record: Called after every control step with the worlds that failed [N] and those that ended otherwise [N].
            What `env.signals` says of these belongs to their next episode already.
        on_step: Called after that.
    """
    with torch.inference_mode():
        for _ in range(round(seconds / env.step_dt)):
            _, _, failed, ended = env.step(policy(env.get_observations()))
            record(failed, ended)
            on_step()


def measuring_physics(sim: SimCfg, timestep: float, verb: str) -> SimCfg:
    """The same control step in finer physics steps, with the elliptic friction cone.

    Args:
        timestep: Physics step, s.
        verb: Who asks, for the message.

    Raises:
        UserError: If it does not divide the control step.
    """
    period = sim.timestep * sim.decimation
    decimation = round(period / timestep)
    if decimation < 1 or abs(decimation * timestep - period) > 1e-9:
        raise UserError(f"{verb}: timestep {timestep:g} s does not divide the task's control step of {period:g} s.")
    return dataclasses.replace(sim, timestep=timestep, decimation=decimation, cone="elliptic")
