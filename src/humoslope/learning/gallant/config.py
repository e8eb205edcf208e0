"""Configuration of Gallant's learner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from humoslope.learning.config import Activation, PpoCfg, Width
from humoslope.ranges import NotEmpty, NotNegative, Range

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv
    from humoslope.learning.learner import Learner

COLUMNS = "voxels"
"""Observation group of the voxel columns."""


@dataclass
class GallantCfg(PpoCfg):
    """Gallant's PPO and networks. Defaults are the original's where it is known, except those marked as ours.

    Actor and critic are networks of their own that see the same. The learning rate follows rsl_rl's rule for both (the
    original's rule is for the actor alone), up to `max_learning_rate`; AdamW has its usual weight decay of 0.01.

    Attributes:
        vector_groups: Observation groups that are encoded together, beside the group "voxels".
        proprioception_dim: Width of the encoder of these groups.
        voxel_channels: Channels of each of three convolutions over the voxels.
        voxel_dim: Width of the encoder of the voxels.
        only_positive_rewards: Learn from rewards of at least 0: the sum of all terms in a step is clipped. The curves
            show the sum as it is.
        max_learning_rate: Highest learning rate.
        clipped_value_loss: Clip the change of values in an update as that of the policy.
    """

    hidden_dims: Annotated[tuple[Width, ...], NotEmpty()] = (256,)
    activation: Activation = "mish"
    num_steps_per_env: Annotated[int, Range(1, 100_000)] = 48
    num_learning_epochs: Annotated[int, Range(1, 1000)] = 4
    learning_rate: Annotated[float, Range(0.0, 1.0, open_low=True)] = 5e-4
    desired_kl: Annotated[float, Range(0.0, 1.0, open_low=True)] = 0.02
    entropy_coef: NotNegative = 0.003
    vector_groups: tuple[str, ...] = ("command", "proprioception", "last_actions")
    proprioception_dim: Width = 256
    voxel_channels: Width = 8
    voxel_dim: Width = 64
    only_positive_rewards: bool = True
    max_learning_rate: Annotated[float, Range(0.0, 1.0, open_low=True)] = 5e-4
    clipped_value_loss: bool = False

    network: ClassVar[str] = "gallant"

    def scale_to(self, preset: Literal["cpu", "gpu"]) -> None:
        """Fewer epochs and shorter rollouts on a CPU; the networks stay, but for the voxel grid, which is the
        observation's."""
        hidden_dims = self.hidden_dims
        super().scale_to(preset)
        self.hidden_dims = hidden_dims
        if preset == "cpu":
            self.num_steps_per_env = 24

    def build(self, env: ManagerBasedRlEnv) -> Learner:
        """Creates the learner for an environment with the observation groups of `vector_groups` and "voxels"."""
        from humoslope.learning.gallant.learner import GallantLearner  # a task can be listed without loading rsl_rl

        return GallantLearner(env, self)

    def network_settings(self, env: ManagerBasedRlEnv) -> dict[str, Any]:
        """The voxel grid of the environment's observation."""
        from humoslope.mdp.voxels import FULL, grid_of

        grid = grid_of(env, COLUMNS)
        return {
            "grid": {"length": grid.length, "low": grid.low, "high": grid.high, "cell": grid.cell},
            "variant": "" if grid.cell == FULL else f"reduced grid {grid}",
        }

    def to_rsl_rl(self) -> dict[str, Any]:
        """The nested dictionary that rsl_rl's runner reads."""
        told = super().to_rsl_rl()
        groups = [*self.vector_groups, COLUMNS]
        told["obs_groups"] = {"actor": groups, "critic": list(groups)}
        for name in ("actor", "critic"):
            told[name] |= {
                "class_name": "humoslope.learning.gallant.network:GallantNetwork",
                "proprioception_dim": self.proprioception_dim,
                "voxel_channels": self.voxel_channels,
                "voxel_dim": self.voxel_dim,
            }
        told["algorithm"] |= {
            "class_name": "humoslope.learning.gallant.learner:CappedPpo",
            "max_learning_rate": self.max_learning_rate,
            "optimizer": "adamw",
            "use_clipped_value_loss": self.clipped_value_loss,
        }
        return told
