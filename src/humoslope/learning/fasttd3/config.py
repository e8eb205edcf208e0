"""Configuration of FastTD3."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import torch

from humoslope.errors import UserError
from humoslope.learning.config import AgentCfg
from humoslope.ranges import Finite, NotEmpty, NotNegative, NotNegativeSpan, Positive, Range, Share

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv
    from humoslope.learning.learner import Learner

Widths = Annotated[tuple[Annotated[int, Range(1, 16_384)], ...], NotEmpty()]
Count = Annotated[int, Range(1)]
Discount = Annotated[float, Range(0.0, 1.0, open_high=True)]
Rate = Annotated[float, Range(0.0, 1.0, open_low=True)]


@dataclass
class FastTd3Cfg(AgentCfg):
    """FastTD3. Defaults are its authors' for the G1 on rough ground in Isaac Lab, except those marked as ours.

    Attributes:
        hidden_dims: Widths of the actor's hidden layers, with ReLU.
        critic_hidden_dims: Widths of the hidden layers of both critics, with ReLU.
        action_bound: Largest absolute value of an action (ours: 3; policies of Stage I and II use up to 2.7).
        least_obs_std: Least standard deviation that an observation is divided by, as in `PpoCfg` (ours).
        num_atoms: Number of returns, evenly spaced, over which a critic gives a distribution.
        v_min: Lowest of these returns.
        v_max: Highest of these returns.
        clipped_double_q: Let both critics learn from the one that expects less, and the actor from the lower of the two
            expectations; else each learns from itself, and the actor from their mean.
        gamma: Discount factor of a control step.
        n_step: Largest number of rewards that a target adds up before the critics' estimate of the rest.
        num_updates: Updates of the critics for each control step of all envs.
        batch_size: Transitions of an update.
        policy_frequency: Updates of the critics for each one of the actor.
        tau: Share of the critics that the target critics take over in each update.
        learning_rate: Learning rate of AdamW for actor and critics.
        weight_decay: Weight decay of AdamW.
        exploration_std: Lowest and highest standard deviation of the exploration noise, as a share of the action bound.
            Every env draws one of its own for each episode (ours: up to 0.3, since the bound is wider than 1).
        target_noise: Standard deviation of the noise on the actions in targets, as a share of the action bound.
        target_noise_clip: Bound on that noise.
        buffer_steps: Control steps of every env that the replay buffer holds (ours: 1024; the authors have 5120).
        learning_starts: Control steps that it must hold before learning begins.
        refill_steps: Control steps that a resumed run collects before it learns on, as its buffer is empty (ours).
        half_precision_replay: Keep observations and actions in float16 in the buffer (ours).
        symmetry: Learn from the left/right mirror image of half of each batch (ours).
        mixed_precision: Run the updates in bfloat16; pays on GPUs and on CPUs with bfloat16 instructions.
    """

    hidden_dims: Widths = (512, 256, 128)
    critic_hidden_dims: Widths = (1024, 512, 256)
    action_bound: Positive = 3.0
    least_obs_std: NotNegative = 0.1
    num_atoms: Annotated[int, Range(2)] = 251
    v_min: Finite = -10.0
    v_max: Finite = 10.0
    clipped_double_q: bool = True
    gamma: Discount = 0.99
    n_step: Count = 8
    num_updates: Count = 4
    batch_size: Count = 32_768
    policy_frequency: Count = 2
    tau: Rate = 0.1
    learning_rate: Positive = 3e-4
    weight_decay: NotNegative = 0.1
    exploration_std: NotNegativeSpan = (0.001, 0.3)
    target_noise: NotNegative = 0.001
    target_noise_clip: Share = 0.5
    # More than any memory holds, so that a user who asks for too much reads how many fit.
    buffer_steps: Annotated[int, Range(1, 1_000_000_000)] = 1024
    learning_starts: Count = 10
    refill_steps: Annotated[int, Range(0)] = 500
    half_precision_replay: bool = True
    symmetry: bool = False
    mixed_precision: bool = True

    # The support is part of what the critics mean, and the bound of what the actor does.
    START_ONLY: ClassVar[tuple[str, ...]] = ("learning_rate", "weight_decay", "action_bound", "v_min", "v_max")

    def scale_to(self, preset: Literal["cpu", "gpu"]) -> None:
        """On a CPU smaller networks and batches, fewer updates, and the horizon of the authors' smaller runs."""
        if preset == "cpu":
            self.hidden_dims, self.critic_hidden_dims = (256, 128, 64), (512, 256, 128)
            self.num_atoms, self.gamma = 101, 0.97
            self.num_updates, self.batch_size, self.buffer_steps = 2, 2048, 2000
            # Only where the CPU multiplies in bfloat16 itself; compare with --agent.no-mixed-precision.
            self.mixed_precision = bool(torch.cpu.get_capabilities().get("avx512_bf16", False))

    def check(self) -> None:
        """Raises UserError if a value is impossible."""
        super().check()
        if self.v_min >= self.v_max:
            raise UserError(f"agent.v_min {self.v_min:g} must be less than v_max {self.v_max:g}.")

    def build(self, env: ManagerBasedRlEnv) -> Learner:
        """Creates the learner for an environment with the observation groups "actor" and "critic"."""
        from humoslope.learning.fasttd3.learner import FastTd3  # a task can be listed without loading rsl_rl

        return FastTd3(env, self)
