"""A trained policy out of a checkpoint, without a training run around it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError, unknown
from humoslope.learning import checkpoint
from humoslope.learning.networks import find_network

GROUP = "actor"


@dataclass(frozen=True)
class PolicySpec:
    """A description from which the network of a policy is rebuilt.

    Attributes:
        network: Name that the network is registered under, such as "mlp".
        groups: Observation groups that it reads, in its order.
        shapes: Shape of one env's observation in each of these groups.
        num_actions: Size of an action.
        settings: Further arguments of the network.
    """

    network: str
    groups: tuple[str, ...]
    shapes: tuple[tuple[int, ...], ...]
    num_actions: int
    settings: Mapping[str, Any]

    @classmethod
    def of(
        cls, env: ManagerBasedRlEnv, network: str, groups: tuple[str, ...], settings: Mapping[str, Any]
    ) -> PolicySpec:
        """The specification of a network for the observations and joints of an environment.

        Raises:
            UserError: If the environment has no such group.
        """
        return cls(network, groups, shapes_of(env, groups), env.robot.num_joints, settings)

    @property
    def variant(self) -> str:
        """What sets the network apart from others of its task, such as "reduced grid 16 x 16 x 20 of 10 cm"; results
        are called by it."""
        return str(self.settings.get("variant", ""))

    def build(self, device: torch.device | str) -> torch.nn.Module:
        """The network with fresh weights.

        Raises:
            UserError: If no such network is registered, or the settings do not fit it.
        """
        make = find_network(self.network)
        try:
            return make(self.example(), self.groups, self.num_actions, **self.settings).to(device)
        except (TypeError, ValueError) as error:
            raise UserError(
                f"network '{self.network}' cannot be built for groups of {self._sizes()}: {error}"
            ) from None

    def example(self) -> TensorDict:
        """Observations of one env, all zero."""
        groups = {name: torch.zeros(1, *shape) for name, shape in zip(self.groups, self.shapes, strict=True)}
        return TensorDict(groups, batch_size=[1])

    def check_fits(self, env: ManagerBasedRlEnv, path: Path) -> None:
        """Raises UserError if the environment has other observations or actions than the policy was trained with."""
        given = shapes_of(env, self.groups)
        for group, trained, now in zip(self.groups, self.shapes, given, strict=True):
            if trained != now:
                raise _misfit(path, f"{_size(trained)} observations", _size(now), env, group)
        if self.num_actions != env.robot.num_joints:
            raise _misfit(path, f"{self.num_actions} actions", str(env.robot.num_joints), env)

    def _sizes(self) -> str:
        return ", ".join(f"{name} {_size(shape)}" for name, shape in zip(self.groups, self.shapes, strict=True))


@dataclass(frozen=True)
class Provenance:
    """The origin of a checkpoint, as the file itself records it.

    Attributes:
        path: The file.
        sha256: SHA-256 of the file, hexadecimal.
        task: Name of the trained task.
        iteration: Number of training iterations before this one; None for a policy from outside.
        total_steps: Number of environment steps seen; None for a policy from outside.
        harness: Scale in [0, 1] that the training harness had come down to, where it held more, of robots that walked
            and of those that stood; None if the run had no harness.
        parent: The checkpoint that its training started from; None if it started from nothing.
        formerly: SHA-256 of the files it was converted from, under which older results and calibrations know it.
        variant: What sets its network apart from others of its task (see `PolicySpec.variant`), or where a policy from
            outside comes from.
    """

    path: Path
    sha256: str
    task: str
    iteration: int | None
    total_steps: int | None
    harness: float | None
    parent: Provenance | None = None
    formerly: tuple[str, ...] = ()
    variant: str = ""

    @property
    def name(self) -> str:
        """The task, with the variant."""
        return f"{self.task}, {self.variant}" if self.variant else self.task

    @property
    def title(self) -> str:
        """The name, with the iteration if there is one."""
        return self.name if self.iteration is None else f"{self.name}, iteration {self.iteration}"

    @property
    def seen(self) -> str:
        """The environment steps seen, such as "62.74 M steps"."""
        return "trained elsewhere" if self.total_steps is None else f"{self.total_steps / 1e6:.2f} M steps"

    @property
    def training(self) -> str:
        """The assistance that its training had, in a sentence for each stage."""
        if self.iteration is None:
            return "It was trained elsewhere, and nothing is known here of its training."
        if self.harness is None:
            said = "Its training used no harness."
        else:
            left = "was gone" if self.harness == 0.0 else f"still had {100.0 * self.harness:.3g} % of its strength"
            said = f"Its training used the harness, which {left} at this checkpoint."
        if self.parent is None:
            return said
        return f"{said} It started from {self.parent.task} after {self.parent.seen}: {self.parent.training}"


class Actor:
    """A policy that always takes its most likely action.

    Attributes:
        module: The network with its normaliser.
        spec: Its description.
        provenance: The checkpoint that it comes from.
    """

    def __init__(self, module: torch.nn.Module, spec: PolicySpec, provenance: Provenance) -> None:
        self.module = module
        self.spec = spec
        self.provenance = provenance

    @torch.inference_mode()
    def __call__(self, obs: TensorDict) -> Tensor:
        """Actions [N, J] for the observations of all envs."""
        action: Tensor = self.module(obs)
        return action


def shapes_of(env: ManagerBasedRlEnv, groups: tuple[str, ...]) -> tuple[tuple[int, ...], ...]:
    """Shape of one env's observation in each of `groups`.

    Raises:
        UserError: If the environment lacks a group.
    """
    obs = env.get_observations()
    for group in groups:
        if group not in obs:
            raise unknown("observation group", group, map(str, obs.keys()))
    return tuple(tuple(obs[group].shape[1:]) for group in groups)


def find_checkpoint(path: Path) -> Path:
    """`path` itself, or the newest checkpoint in it if it is a run folder.

    Raises:
        UserError: If there is none.
    """
    return checkpoint.latest(path) if path.is_dir() else path


def read_provenance(path: Path, task: str | None = None) -> Provenance:
    """The origin of a checkpoint.

    Args:
        task: The task it must belong to; None for any.

    Raises:
        UserError: If it is no checkpoint, or of another task.
    """
    return provenance_of(path, checkpoint.load(path, task))


def read_spec(path: Path) -> PolicySpec:
    """The description of the network in a checkpoint.

    Raises:
        UserError: If it is no checkpoint.
    """
    return spec_of(checkpoint.load(path))


def spec_of(state: Mapping[str, Any]) -> PolicySpec:
    """The description of the network in a checkpoint that was loaded."""
    return PolicySpec(**state["policy"]["spec"])


def load_actor(path: Path, env: ManagerBasedRlEnv, task: str | None = None) -> Actor:
    """The policy of a checkpoint, for the observations and joints of `env`.

    Args:
        task: The task it must belong to; None for any.

    Raises:
        UserError: If it is no checkpoint, of another task, or does not fit the environment.
    """
    state = checkpoint.load(path, task, env.device)
    spec = spec_of(state)
    spec.check_fits(env, path)
    module = spec.build(env.device)
    load_weights(module, state, path)
    return Actor(module.eval(), spec, provenance_of(path, state))


def load_weights(module: torch.nn.Module, state: Mapping[str, Any], path: Path) -> None:
    """Puts the policy of a loaded checkpoint into a network.

    Raises:
        UserError: If they are of another network.
    """
    try:
        module.load_state_dict(state["policy"]["weights"])
    except RuntimeError as error:
        detail = str(error).strip().splitlines()[-1].strip()
        raise UserError(f"checkpoint '{path}' does not hold the network that it describes: {detail}") from None


def parent_record(path: Path, state: Mapping[str, Any]) -> dict[str, Any]:
    """Record of a checkpoint in those of the run that starts from it."""
    return {
        "path": str(path),
        "sha256": checkpoint.digest(path),
        **{name: state[name] for name in ("task", "iteration", "total_steps", "parent", "formerly")},
        "curriculum": state["env"]["curriculum"],
    }


def spec_state(spec: PolicySpec) -> dict[str, Any]:
    """The specification as a checkpoint holds it."""
    return asdict(spec)


def provenance_of(path: Path, state: Mapping[str, Any]) -> Provenance:
    """The origin of a checkpoint that was loaded from `path`."""
    record = {"path": path, "sha256": checkpoint.digest(path), "curriculum": state["env"]["curriculum"]}
    return replace(_provenance({**state, **record}), variant=spec_of(state).variant)


def _provenance(record: Mapping[str, Any]) -> Provenance:
    curriculum, parent = record["curriculum"], record["parent"]
    scales = [curriculum[name]["scale"] for name in ("harness", "skills") if name in curriculum]
    left = [float(scale) for some in scales for scale in (some if isinstance(some, list) else [some])]
    return Provenance(
        path=Path(record["path"]),
        sha256=record["sha256"],
        task=record["task"],
        iteration=record["iteration"],
        total_steps=record["total_steps"],
        harness=max(left, default=None),
        parent=None if parent is None else _provenance(parent),
        formerly=tuple(record["formerly"]),
    )


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))


def _misfit(path: Path, trained: str, now: str, env: ManagerBasedRlEnv, group: str = "") -> UserError:
    where = f" in group '{group}'" if group else ""
    return UserError(
        f"checkpoint '{path}' was trained with {trained}{where}, but this environment of {env.robot.name} has {now}; "
        "evaluate it with the code and the task it was trained with."
    )
