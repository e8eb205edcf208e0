"""Parts that all evaluations share: physics, observations, and a policy that drives an environment."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from humoslope.cpu import on_one_thread
from humoslope.env import EnvCfg, ManagerBasedRlEnv, SimCfg
from humoslope.errors import UserError, unknown
from humoslope.managers import ObservationGroupCfg, Terms
from humoslope.statistics import Array


# On one thread the results do not depend on the number of threads: the policy's matrix products may round differently
# with another one.
@on_one_thread
@torch.inference_mode()
def rollout(
    env: ManagerBasedRlEnv,
    policy: Callable[[TensorDict], Tensor],
    seconds: float,
    observe: Callable[[Tensor, Tensor], None],
    on_step: Callable[[], None] = lambda: None,
) -> None:
    """Lets the policy drive all envs for `seconds`.

    Args:
        observe: Called after every control step with the envs that failed [N] and those that ended otherwise [N].
            `env.signals` of these already belong to their next episode.
        on_step: Called after that.
    """
    for _ in range(round(seconds / env.step_dt)):
        _, _, failed, ended = env.step(policy(env.get_observations()))
        observe(failed, ended)
        on_step()


def measuring_physics(sim: SimCfg, timestep: float, verb: str) -> SimCfg:
    """The same control step in finer physics steps, with the elliptic friction cone.

    Args:
        timestep: Physics step, s.
        verb: Command that needs it, for the message.

    Raises:
        UserError: If it does not divide the control step.
    """
    period = sim.timestep * sim.decimation
    decimation = round(period / timestep)
    if decimation < 1 or abs(decimation * timestep - period) > 1e-9:
        raise UserError(f"{verb}: timestep {timestep:g} s does not divide the task's control step of {period:g} s.")
    return dataclasses.replace(sim, timestep=timestep, decimation=decimation, cone="elliptic")


def policy_observations(task_env: EnvCfg, groups: Sequence[str], **changes: Any) -> Terms[ObservationGroupCfg]:
    """The observation groups of a task that a policy reads, without the others.

    Args:
        groups: Their names.
        changes: Fields of each group that are replaced, such as `enable_corruption=False`.

    Raises:
        UserError: If the task does not have one of them.
    """
    offered = dict(task_env.observations.items())
    for name in groups:
        if name not in offered:
            raise unknown("observation group", name, offered)
    return Terms(**{name: dataclasses.replace(offered[name], **changes) for name in groups})


def to_host(values: Tensor) -> Array:
    """The values in double precision on the host. Waits for the device."""
    return values.cpu().numpy().astype(np.float64)
