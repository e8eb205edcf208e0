"""Agent configurations: what every learner has in common, and PPO's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import torch

from humoslope.errors import UserError
from humoslope.extras import require
from humoslope.ranges import NotEmpty, NotNegative, Positive, Range, Share, check_config
from humoslope.strict import StrictCfg

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv
    from humoslope.learning.learner import Learner

LoggerName = Literal["tensorboard", "wandb"]


@dataclass
class AgentCfg(StrictCfg):
    """Base of agent configurations. The type of a task's agent decides which learner trains it.

    Attributes:
        max_iterations: Iterations, each a rollout and an update, after which training is complete.
        num_steps_per_env: Control steps of a rollout.
        save_interval: Iterations between two checkpoints.
        logger: Destination of the curves.
        wandb_project: Project of Weights & Biases, if that is the logger.
    """

    max_iterations: Annotated[int, Range(1, 1_000_000_000)] = 10_000
    num_steps_per_env: Annotated[int, Range(1, 100_000)] = 24
    save_interval: Annotated[int, Range(1, 1_000_000)] = 100
    logger: LoggerName = "tensorboard"
    wandb_project: str = "humoslope"

    START_ONLY: ClassVar[tuple[str, ...]] = ()
    """Fields that only a new run reads: a resumed one continues with the values in its checkpoint."""

    def scale_to(self, preset: Literal["cpu", "gpu"]) -> None:
        """Sets what depends on the size of the machine, such as widths and epochs. Nothing by default."""

    def check(self) -> None:
        """Raises UserError if a value is impossible."""
        check_config("agent", self)
        if self.logger == "wandb":
            require("agent.logger 'wandb'", "wandb")

    def build(self, env: ManagerBasedRlEnv) -> Learner:
        """Creates the learner for an environment.

        Raises:
            UserError: If the configuration does not fit the environment.
        """
        raise UserError(f"agent {type(self).__name__} has no learner; define build(env).")


Width = Annotated[int, Range(1, 16_384)]
"""Number of neurons of a layer."""
Activation = Literal["elu", "selu", "relu", "crelu", "lrelu", "tanh", "sigmoid", "softplus", "gelu", "swish", "mish"]
"""Those that rsl_rl knows by name, except the identity."""


@dataclass
class PpoCfg(AgentCfg):
    """rsl_rl's PPO and its networks. Defaults are Unitree RL Lab's, except those marked as ours.

    Attributes:
        hidden_dims: Widths of the hidden layers of the actor.
        critic_hidden_dims: Widths of those of the critic; the actor's if None.
        activation: Activation after each hidden layer of both.
        init_std: Standard deviation of the first actions.
        obs_normalization: Scale observations by their running mean and standard deviation (ours).
        least_obs_std: Least standard deviation that a normalised observation is divided by (ours). What is always the
            same at first, such as the commanded speed to the side while robots learn to walk, would be huge when it
            changes: the standard deviation is that of all observations since the beginning.
        symmetry: Double every mini-batch by its left/right mirror image (ours; the paper has no symmetry prior).
        num_learning_epochs: Passes over a rollout in one update.
        num_mini_batches: Mini-batches in one pass.
        learning_rate: Learning rate of Adam at the start; adapted to `desired_kl` from there.
        desired_kl: Change of the policy in one update, as KL divergence, that the learning rate is adapted to.
        critic_warmup_iterations: Iterations at the start in which only the critic learns. The estimates of a new critic
            are noise, which would ruin an actor that can walk already.
        gamma: Discount factor of a control step.
        lam: Discount factor of generalised advantage estimation.
        clip_param: Largest change of an action's probability ratio, and of a value, that is rewarded.
        value_loss_coef: Weight of the value loss.
        entropy_coef: Weight of the entropy bonus (ours: 0.003; Unitree RL Lab has 0.01).
        final_entropy_coef: Weight of the entropy bonus in the last iteration, to which it falls linearly, so that noise
            does not become part of the gait (ours); the same throughout if None.
        max_grad_norm: Norm that gradients are clipped to.
        torch_compile: Compile actor and critic.
        mixed_precision: Run the update in bfloat16; pays on GPUs and on CPUs with bfloat16 instructions.
    """

    hidden_dims: Annotated[tuple[Width, ...], NotEmpty()] = (512, 256, 128)
    critic_hidden_dims: Annotated[tuple[Width, ...], NotEmpty()] | None = None
    activation: Activation = "elu"
    # Ours, measured on the CPU: 1.0 throws the robot over before it learns to stand.
    init_std: Annotated[float, Range(1e-3, 100.0)] = 0.8
    obs_normalization: bool = True
    least_obs_std: NotNegative = 0.1
    symmetry: bool = True
    num_learning_epochs: Annotated[int, Range(1, 1000)] = 5
    num_mini_batches: Annotated[int, Range(1, 100_000)] = 4
    learning_rate: Annotated[float, Range(0.0, 1.0, open_low=True)] = 1e-3
    desired_kl: Annotated[float, Range(0.0, 1.0, open_low=True)] = 0.01
    critic_warmup_iterations: Annotated[int, Range(0, 1_000_000_000)] = 0
    gamma: Share = 0.99
    lam: Share = 0.95
    clip_param: Annotated[float, Range(0.0, 100.0, open_low=True)] = 0.2
    value_loss_coef: NotNegative = 1.0
    entropy_coef: NotNegative = 0.003
    final_entropy_coef: NotNegative | None = None
    max_grad_norm: Positive = 1.0
    torch_compile: bool = False
    mixed_precision: bool = False

    START_ONLY: ClassVar[tuple[str, ...]] = ("init_std", "learning_rate")

    network: ClassVar[str] = "mlp"
    """Name that the actor's network is registered under."""

    def network_settings(self, env: ManagerBasedRlEnv) -> dict[str, Any]:
        """Arguments of actor and critic that follow from the environment, beyond those of `to_rsl_rl`."""
        return {}

    def scale_to(self, preset: Literal["cpu", "gpu"]) -> None:
        """Smaller networks and fewer epochs on a CPU."""
        if preset == "cpu":
            self.hidden_dims = (256, 128, 128)
            self.num_learning_epochs = 2
            # Only where the CPU multiplies in bfloat16 itself; compare with --agent.no-mixed-precision.
            self.mixed_precision = bool(torch.cpu.get_capabilities().get("avx512_bf16", False))

    def build(self, env: ManagerBasedRlEnv) -> Learner:
        """Creates rsl_rl's PPO for an environment with the observation groups "actor" and "critic"."""
        from humoslope.learning.ppo import PpoLearner  # a task can be listed without loading rsl_rl

        return PpoLearner(env, self)

    def to_rsl_rl(self) -> dict[str, Any]:
        """The nested dictionary that rsl_rl's runner reads.

        Raises:
            UserError: If a value is impossible.
        """
        self.check()
        network = {
            "class_name": "humoslope.learning.networks:Network",
            "activation": self.activation,
            "obs_normalization": self.obs_normalization,
            "least_std": self.least_obs_std,
        }
        return {
            "num_steps_per_env": self.num_steps_per_env,
            "save_interval": self.save_interval,
            "obs_groups": {"actor": ["actor"], "critic": ["critic"]},
            # The environment watches for non-finite values itself, without waiting for the device.
            "check_for_nan": False,
            "torch_compile_mode": "default" if self.torch_compile else None,
            "actor": network
            | {
                "hidden_dims": list(self.hidden_dims),
                "distribution_cfg": {"class_name": "GaussianDistribution", "init_std": self.init_std},
            },
            "critic": network | {"hidden_dims": list(self.critic_hidden_dims or self.hidden_dims)},
            "algorithm": {
                "class_name": "humoslope.learning.ppo:WarmStartPpo",
                "num_learning_epochs": self.num_learning_epochs,
                "num_mini_batches": self.num_mini_batches,
                "learning_rate": self.learning_rate,
                "schedule": "adaptive",
                "desired_kl": self.desired_kl,
                "gamma": self.gamma,
                "lam": self.lam,
                "clip_param": self.clip_param,
                "value_loss_coef": self.value_loss_coef,
                "entropy_coef": self.entropy_coef,
                "max_grad_norm": self.max_grad_norm,
                "use_mixed_precision": self.mixed_precision,
            },
        }
