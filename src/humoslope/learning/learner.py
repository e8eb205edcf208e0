"""The seam between the training loop and the algorithms: what a learner does for the loop."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import torch
from tensordict import TensorDict
from torch import Tensor

from humoslope.learning.policy import PolicySpec


class Transition(NamedTuple):
    """One control step of all envs.

    Attributes:
        obs: Observations that the action answers, each group [N, ...].
        action: [N, J].
        reward: [N].
        terminated: [N] bool; episodes that ended in failure, so that nothing follows.
        time_outs: [N] bool; episodes that were cut off, so that the value of what would have followed counts.
        next_obs: Observations after the step. Where an episode ended they belong to the next one; a learner that asks
            for terminal observations finds those at which it ended in `terminal_obs`.
        terminal_obs: Like `next_obs`, but before resets; None unless the learner asks for it.
    """

    obs: TensorDict
    action: Tensor
    reward: Tensor
    terminated: Tensor
    time_outs: Tensor
    next_obs: TensorDict
    terminal_obs: TensorDict | None

    @property
    def done(self) -> Tensor:
        """[N] bool; episodes that ended in either way."""
        return self.terminated | self.time_outs


class Learner(Protocol):
    """An algorithm that learns from the transitions that the training loop hands it.

    An agent configuration builds it (`AgentCfg.build`). The loop (`Trainer`) collects `num_steps_per_env` steps with
    `act` and `take`, then calls `update`; it logs, saves, stops and resumes alike for every learner.

    Attributes:
        spec: The network that acts, so that a checkpoint can rebuild it without the learner.
        policy: That network: a module from observations to the deterministic action [N, J], with its normaliser.
        wants_terminal_obs: Whether transitions hold the observations at which episodes ended.
    """

    spec: PolicySpec
    policy: torch.nn.Module
    wants_terminal_obs: bool

    def begin(self, iteration: int) -> None:
        """Prepares the rollout and the update of an iteration."""

    def act(self, obs: TensorDict) -> Tensor:
        """The exploring action [N, J]. Called in inference mode."""

    def take(self, transition: Transition) -> None:
        """Takes one step into the rollout or the replay buffer. Called in inference mode."""

    def update(self, obs: TensorDict) -> dict[str, float]:
        """Learns from what was taken.

        Args:
            obs: The present observations, with which the next rollout begins.

        Returns:
            Curves by name, such as "Loss/value".
        """

    def synchronise(self) -> None:
        """Gives every process of a distributed run the weights of the first one; nothing to do in a single one."""

    def remarks(self) -> list[str]:
        """Sentences that the user should read, since the last call: warnings, and what a resumed run starts without."""

    def state_dict(self) -> dict[str, Any]:
        """Everything beyond the policy that a resumed run needs (critics, optimisers, counters), as tensors and plain
        types."""

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict`.

        Raises:
            RuntimeError: If the state is of other networks.
        """
