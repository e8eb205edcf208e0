"""Letting a policy drive an environment while something watches."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDict
from torch import Tensor

from humoslope.env import ManagerBasedRlEnv


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
