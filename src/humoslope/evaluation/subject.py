"""A policy that is measured in the training simulator, whatever file it lies in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tensordict import TensorDict
from torch import Tensor

from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.learning.policy import Provenance, load_actor, read_spec
from humoslope.registry import TaskCfg
from humoslope.shipped import found

Policy = Callable[[TensorDict], Tensor]
"""Actions [N, J] for the observations of all envs."""


@dataclass(frozen=True)
class Subject:
    """A policy, and the environment that it needs.

    Attributes:
        provenance: Its origin.
        env: Environment with its robot, actions and observations; an evaluation replaces the rest.
        groups: Observation groups that it reads.
        load: Function that returns the policy for an environment with these.
    """

    provenance: Provenance
    env: EnvCfg
    groups: tuple[str, ...]
    load: Callable[[ManagerBasedRlEnv], Policy]

    def beside(self, ending: str) -> Path:
        """Returns the path of a result: beside a checkpoint, with its name, or in an export folder."""
        path = self.provenance.path
        return path / ending if found(path).is_dir() else path.with_suffix(f".{ending}")


def of_checkpoint(provenance: Provenance, task: TaskCfg) -> Subject:
    """Returns the policy of a checkpoint with the task that it was trained on."""
    path = provenance.path
    return Subject(provenance, task.env, read_spec(path).groups, lambda env: load_actor(path, env, provenance.task))
