"""A trained actor out of a checkpoint, without a training run around it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import Tensor

from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.learning import checkpoint
from humoslope.learning.config import AgentCfg
from humoslope.learning.networks import Network

GROUP = "actor"
"""The observation group that actors read."""


@dataclass(frozen=True)
class Provenance:
    """What a checkpoint says of itself.

    Attributes:
        path: The file.
        sha256: Of the file, hexadecimal.
        task: What was trained.
        iteration: Training iterations done before this one.
        total_steps: Environment steps seen.
        harness: Scale in [0, 1] that the training harness had come down to; None if the run had no harness.
        ancestor: What its training started from; None if it started from nothing.
    """

    path: Path
    sha256: str
    task: str
    iteration: int
    total_steps: int
    harness: float | None
    ancestor: Provenance | None = None

    @property
    def training(self) -> str:
        """What the training was helped by, in a sentence for each stage."""
        if self.harness is None:
            said = "Its training used no harness."
        else:
            left = "was gone" if self.harness == 0.0 else f"still had {100.0 * self.harness:.3g} % of its strength"
            said = f"Its training used the harness, which {left} at this checkpoint."
        if self.ancestor is None:
            return said
        steps = f"{self.ancestor.total_steps / 1e6:.2f} M steps"
        return f"{said} It started from {self.ancestor.task} after {steps}: {self.ancestor.training}"


@dataclass(frozen=True)
class PolicySpec:
    """What a policy is made of.

    Attributes:
        groups: Observation groups that it reads.
    """

    groups: tuple[str, ...] = (GROUP,)


class Actor:
    """A policy that always takes its most likely action.

    Attributes:
        module: The network with its normaliser.
        provenance: Where it comes from.
    """

    def __init__(self, module: MLPModel, provenance: Provenance) -> None:
        self.module = module
        self.provenance = provenance
        self.spec = PolicySpec()

    @torch.inference_mode()
    def __call__(self, obs: TensorDict) -> Tensor:
        """Actions [N, J] for the observations of all worlds."""
        action: Tensor = self.module(obs)
        return action


def find_checkpoint(path: Path) -> Path:
    """`path` itself, or the newest checkpoint in it if it is a run folder.

    Raises:
        UserError: If there is none.
    """
    return checkpoint.latest(path) if path.is_dir() else path


def read_provenance(path: Path, task: str | None = None) -> Provenance:
    """What a checkpoint says of itself.

    Args:
        task: The task it must belong to; None for any.

    Raises:
        UserError: If it is no checkpoint, or of another task.
    """
    return _provenance(path, checkpoint.load(path, task))


def load_actor(path: Path, env: ManagerBasedRlEnv, task: str | None = None) -> Actor:
    """The actor of a checkpoint, for the observations and joints of `env`. Its layers are as wide as they were trained.

    Args:
        task: The task it must belong to; None for any.

    Raises:
        UserError: If it is no checkpoint, of another task, or does not fit the environment.
    """
    state = checkpoint.load(path, task, env.device)
    weights = state["actor_state_dict"]
    layers = _layers(path, weights)
    obs = env.get_observations()
    _check_size(path, "observations", layers[0].shape[1], obs[GROUP].shape[1], env)
    _check_size(path, "actions", layers[-1].shape[0], env.robot.num_joints, env)
    # What cannot be read off the weights (activation, distribution) is the same for every agent.
    cfg = AgentCfg(
        hidden_dims=hidden_dims(path, weights),
        obs_normalization=any(name.startswith("obs_normalizer.") for name in weights),
    ).to_rsl_rl()
    network = {name: value for name, value in cfg["actor"].items() if name != "class_name"}
    model = Network(obs, {GROUP: [GROUP]}, GROUP, env.robot.num_joints, **network).to(env.device)
    try:
        model.load_state_dict(weights)
    except RuntimeError as error:
        detail = str(error).strip().splitlines()[-1].strip()
        raise UserError(f"checkpoint '{path}' holds another kind of actor: {detail}") from None
    return Actor(model.eval(), _provenance(path, state))


def hidden_dims(path: Path, weights: dict[str, Tensor]) -> tuple[int, ...]:
    """Widths of the hidden layers of an actor's `weights`.

    Raises:
        UserError: If it has none.
    """
    return tuple(layer.shape[0] for layer in _layers(path, weights)[:-1])


def _layers(path: Path, weights: dict[str, Tensor]) -> list[Tensor]:
    """The weights [out, in] of the network's linear layers, from the first to the last."""
    numbers = sorted(
        int(name.split(".")[1]) for name in weights if name.startswith("mlp.") and name.endswith(".weight")
    )
    if len(numbers) < 2:
        raise UserError(f"checkpoint '{path}' holds another kind of actor: it has no hidden layer.")
    return [weights[f"mlp.{number}.weight"] for number in numbers]


def _check_size(path: Path, what: str, trained: int, given: int, env: ManagerBasedRlEnv) -> None:
    if trained != given:
        raise UserError(
            f"checkpoint '{path}' was trained with {trained} {what}, but this environment of {env.robot.name} has "
            f"{given}; evaluate it with the code and the task it was trained with."
        )


def _provenance(path: Path, state: dict[str, Any]) -> Provenance:
    return _told(state | {"path": path, "sha256": checkpoint.digest(path), "curriculum": state["env"]["curriculum"]})


def _told(said: dict[str, Any]) -> Provenance:
    harness, ancestor = said["curriculum"].get("harness"), said.get("ancestor")
    return Provenance(
        path=Path(said["path"]),
        sha256=said["sha256"],
        task=said["task"],
        iteration=said["iter"],
        total_steps=said["total_steps"],
        harness=None if harness is None else float(harness["scale"]),
        ancestor=None if ancestor is None else _told(ancestor),
    )
