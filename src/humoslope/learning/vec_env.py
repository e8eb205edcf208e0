"""The environment as rsl_rl sees it."""

from __future__ import annotations

from typing import Any

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from humoslope.env import ManagerBasedRlEnv


class RslRlVecEnv(VecEnv):
    """Adapts `ManagerBasedRlEnv` to rsl_rl's `VecEnv`."""

    def __init__(self, env: ManagerBasedRlEnv) -> None:
        self.env = env
        self.num_envs = env.num_envs
        self.num_actions = env.robot.num_joints
        self.max_episode_length = env.max_episode_length
        self.device = env.device
        self.cfg: Any = env.cfg

    @property
    def episode_length_buf(self) -> Tensor:
        """Control steps since the last reset, [N]."""
        return self.env.episode_length_buf

    @episode_length_buf.setter
    def episode_length_buf(self, value: Tensor) -> None:
        self.env.episode_length_buf = value

    def get_observations(self) -> TensorDict:
        """The present observations."""
        return self.env.get_observations()

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Tensor]]:
        """One control step; `dones` holds failures and time-outs, the latter are bootstrapped by the learner."""
        obs, reward, terminated, time_outs = self.env.step(actions)
        return obs, reward, (terminated | time_outs).to(torch.int64), {"time_outs": time_outs}
