"""A small off-policy learner and a policy with an image as input, as a user would write them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from tensordict import TensorDict
from torch import Tensor, nn

from humoslope.env import ManagerBasedRlEnv
from humoslope.learning.config import AgentCfg
from humoslope.learning.learner import Learner, Transition
from humoslope.learning.networks import network
from humoslope.learning.policy import PolicySpec
from humoslope.managers import ObservationGroupCfg, ObservationTermCfg, Terms
from humoslope.mdp.declare import measured_as
from humoslope.registry import TaskCfg
from tasks.stage1 import stage1


class Tanh(nn.Module):
    """One hidden layer over the actor's group; actions in (-1, 1)."""

    def __init__(self, inputs: int, outputs: int, width: int, group: str) -> None:
        super().__init__()
        self.group = group
        self.layers = nn.Sequential(nn.Linear(inputs, width), nn.ELU(), nn.Linear(width, outputs), nn.Tanh())

    def forward(self, obs: TensorDict) -> Tensor:
        action: Tensor = self.layers(obs[self.group])
        return action


@network("toy-tanh")
def tanh(obs: TensorDict, groups: tuple[str, ...], num_actions: int, width: int) -> nn.Module:
    return Tanh(obs[groups[0]].shape[1], num_actions, width, groups[0])


@dataclass
class ToyTd3Cfg(AgentCfg):
    """Deterministic policy gradient with one critic and a ring of transitions.

    Attributes:
        width: Width of the hidden layers.
        learning_rate: Learning rate of both networks.
        noise: Standard deviation of the exploration noise.
        buffer_steps: Control steps that the ring holds.
    """

    width: int = 16
    learning_rate: float = 1e-3
    noise: float = 0.2
    buffer_steps: int = 8

    START_ONLY: ClassVar[tuple[str, ...]] = ("learning_rate",)

    def build(self, env: ManagerBasedRlEnv) -> Learner:
        return ToyTd3(env, self)


class ToyTd3:
    """What a learner is to the loop, in as few lines as it takes."""

    wants_terminal_obs = True

    def __init__(self, env: ManagerBasedRlEnv, cfg: ToyTd3Cfg) -> None:
        self.cfg = cfg
        self.spec = PolicySpec.of(env, "toy-tanh", ("actor",), {"width": cfg.width})
        self.policy = self.spec.build(env.device)
        (size,), actions = self.spec.shapes[0], self.spec.num_actions
        self.critic = nn.Sequential(nn.Linear(size + actions, cfg.width), nn.ELU(), nn.Linear(cfg.width, 1))
        parameters = [*self.policy.parameters(), *self.critic.parameters()]
        self.optimizer = torch.optim.Adam(parameters, lr=cfg.learning_rate)
        shape = (cfg.buffer_steps, env.num_envs)
        self.ring = {
            "obs": torch.zeros(*shape, size),
            "action": torch.zeros(*shape, actions),
            "reward": torch.zeros(*shape),
            "terminated": torch.zeros(*shape, dtype=torch.bool),
            "next": torch.zeros(*shape, size),
        }
        self.taken = 0
        self.terminal_differed = 0

    def begin(self, iteration: int) -> None:
        pass

    def act(self, obs: TensorDict) -> Tensor:
        action = self.policy(obs)
        return action + self.cfg.noise * torch.randn_like(action)

    def take(self, transition: Transition) -> None:
        assert transition.terminal_obs is not None
        row = self.taken % self.cfg.buffer_steps
        self.ring["obs"][row] = transition.obs["actor"]
        self.ring["action"][row] = transition.action
        self.ring["reward"][row] = transition.reward
        self.ring["terminated"][row] = transition.terminated
        self.ring["next"][row] = transition.terminal_obs["actor"]
        differs = (transition.terminal_obs["actor"] != transition.next_obs["actor"]).any(dim=1)
        assert not (differs & ~transition.done).any()
        self.terminal_differed += int(differs.sum())
        self.taken += 1

    def update(self, obs: TensorDict) -> dict[str, float]:
        rows = min(self.taken, self.cfg.buffer_steps)
        batch = {name: values[:rows].flatten(0, 1) for name, values in self.ring.items()}
        with torch.no_grad():
            follows = self._value(batch["next"], self.policy(self._as_obs(batch["next"])))
            target = batch["reward"] + 0.9 * follows * ~batch["terminated"]
        loss = (self._value(batch["obs"], batch["action"]) - target).square().mean()
        gain = self._value(batch["obs"], self.policy(self._as_obs(batch["obs"]))).mean()
        self.optimizer.zero_grad()
        (loss - 0.01 * gain).backward()
        self.optimizer.step()
        return {"Loss/critic": loss.item(), "Loss/gain": gain.item()}

    def synchronise(self) -> None:
        pass

    def remarks(self) -> list[str]:
        return []

    def state_dict(self) -> dict[str, Any]:
        return {"critic": self.critic.state_dict(), "optimizer": self.optimizer.state_dict(), "taken": self.taken}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.critic.load_state_dict(state["critic"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.taken = state["taken"]

    def _value(self, obs: Tensor, action: Tensor) -> Tensor:
        value: Tensor = self.critic(torch.cat([obs, action], dim=1)).squeeze(1)
        return value

    def _as_obs(self, obs: Tensor) -> TensorDict:
        return TensorDict({"actor": obs}, batch_size=[len(obs)])


def toy_td3() -> TaskCfg:
    """Stage I's world for the toy off-policy learner."""
    cfg = stage1()
    cfg.agent = ToyTd3Cfg()
    return cfg


@measured_as("custom")
def scan_image(env: ManagerBasedRlEnv) -> Tensor:
    """The height scan as an image [N, 1, 7, 7]."""
    size = env.height_scan.cfg.size
    return env.height_scan.heights_w.view(env.num_envs, 1, size, size) - env.signals.root_pos_w[:, 2, None, None, None]


@dataclass
class ToyImageCfg(ToyTd3Cfg):
    """The toy learner with rsl_rl's CNN over the ground ahead, beside proprioception.

    Attributes:
        channels: Channels of the convolution.
    """

    channels: int = 2
    hidden_dims: tuple[int, ...] = field(default=(16,))

    def build(self, env: ManagerBasedRlEnv) -> Learner:
        return ToyImage(env, self)


class ToyImage(ToyTd3):
    """Trains nothing but the policy, towards zero action: what counts is that images pass through every verb."""

    wants_terminal_obs = False

    def __init__(self, env: ManagerBasedRlEnv, cfg: ToyImageCfg) -> None:
        settings = {
            "hidden_dims": list(cfg.hidden_dims),
            "cnn_cfg": {"output_channels": [cfg.channels], "kernel_size": 3},
        }
        self.cfg = cfg
        self.spec = PolicySpec.of(env, "cnn", ("actor", "ground"), settings)
        self.policy = self.spec.build(env.device)
        self.optimizer = torch.optim.Adam(self.policy.parameters(), lr=cfg.learning_rate)
        self.taken = 0

    def take(self, transition: Transition) -> None:
        self.taken += 1

    def update(self, obs: TensorDict) -> dict[str, float]:
        loss = self.policy(obs.clone()).square().mean()
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        return {"Loss/size": loss.item()}

    def state_dict(self) -> dict[str, Any]:
        return {"optimizer": self.optimizer.state_dict(), "taken": self.taken}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.optimizer.load_state_dict(state["optimizer"])
        self.taken = state["taken"]


def toy_image() -> TaskCfg:
    """Stage I's world for a policy that sees the ground as an image."""
    cfg = stage1()
    cfg.agent = ToyImageCfg()
    cfg.env.observations.ground = ObservationGroupCfg(terms=Terms(scan=ObservationTermCfg(scan_image)))
    return cfg
