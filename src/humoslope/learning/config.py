"""Agent configurations: what every learner has in common, and PPO's own."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, ClassVar, Literal, get_args

import torch

from humoslope.errors import UserError, unknown
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

    max_iterations: int = 10_000
    num_steps_per_env: int = 24
    save_interval: int = 100
    logger: LoggerName = "tensorboard"
    wandb_project: str = "humoslope"

    START_ONLY: ClassVar[tuple[str, ...]] = ()
    """Fields that only a new run reads: a resumed one continues with the values in its checkpoint."""

    def scale_to(self, preset: Literal["cpu", "gpu"]) -> None:
        """Sets what depends on the size of the machine, such as widths and epochs. Nothing by default."""

    def check(self) -> None:
        """Raises UserError if a value is impossible."""
        for name in ("max_iterations", "num_steps_per_env", "save_interval"):
            require_at_least_one(self, name)
        if self.logger not in get_args(LoggerName):
            raise unknown("agent.logger", self.logger, get_args(LoggerName))
        if self.logger == "wandb" and find_spec("wandb") is None:
            raise UserError("agent.logger 'wandb' needs a package that is not installed: pip install '.[wandb]'.")

    def build(self, env: ManagerBasedRlEnv) -> Learner:
        """Creates the learner for an environment.

        Raises:
            UserError: If the configuration does not fit the environment.
        """
        raise UserError(f"agent {type(self).__name__} has no learner; define build(env).")


@dataclass
class PpoCfg(AgentCfg):
    """rsl_rl's PPO and its networks. Defaults are Unitree RL Lab's, except those marked as ours.

    Attributes:
        hidden_dims: Widths of the hidden layers of actor and critic, both with ELU.
        init_std: Standard deviation of the first actions.
        obs_normalization: Scale observations by their running mean and standard deviation (ours).
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

    hidden_dims: tuple[int, ...] = (512, 256, 128)
    init_std: float = 0.8  # ours, measured on the CPU: 1.0 throws the robot over before it learns to stand
    obs_normalization: bool = True
    symmetry: bool = True
    num_learning_epochs: int = 5
    num_mini_batches: int = 4
    learning_rate: float = 1e-3
    desired_kl: float = 0.01
    critic_warmup_iterations: int = 0
    gamma: float = 0.99
    lam: float = 0.95
    clip_param: float = 0.2
    value_loss_coef: float = 1.0
    entropy_coef: float = 0.003
    final_entropy_coef: float | None = None
    max_grad_norm: float = 1.0
    torch_compile: bool = False
    mixed_precision: bool = False

    START_ONLY: ClassVar[tuple[str, ...]] = ("init_std", "learning_rate")

    def scale_to(self, preset: Literal["cpu", "gpu"]) -> None:
        """Smaller networks and fewer epochs on a CPU."""
        if preset == "cpu":
            self.hidden_dims = (256, 128, 128)
            self.num_learning_epochs = 2
            # Only where the CPU multiplies in bfloat16 itself; compare with --agent.no-mixed-precision.
            self.mixed_precision = bool(torch.cpu.get_capabilities().get("avx512_bf16", False))

    def check(self) -> None:
        """Raises UserError if a value is impossible."""
        super().check()
        for name in ("num_learning_epochs", "num_mini_batches"):
            require_at_least_one(self, name)
        if self.critic_warmup_iterations < 0:
            raise UserError(f"agent.critic_warmup_iterations {self.critic_warmup_iterations} must be at least 0.")
        for name in ("init_std", "learning_rate", "desired_kl", "clip_param", "max_grad_norm"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise UserError(f"agent.{name} {getattr(self, name)} must be positive.")
        for name in ("value_loss_coef", "entropy_coef", "final_entropy_coef"):
            if getattr(self, name) is not None and not 0.0 <= getattr(self, name) < math.inf:
                raise UserError(f"agent.{name} {getattr(self, name)} must be 0 or more.")
        for name in ("gamma", "lam"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise UserError(f"agent.{name} {getattr(self, name)} must be between 0 and 1.")
        if not self.hidden_dims or min(self.hidden_dims) < 1:
            raise UserError(f"agent.hidden_dims {self.hidden_dims} must be one or more widths of at least 1.")

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
            "hidden_dims": list(self.hidden_dims),
            "activation": "elu",
            "obs_normalization": self.obs_normalization,
        }
        return {
            "num_steps_per_env": self.num_steps_per_env,
            "save_interval": self.save_interval,
            "obs_groups": {"actor": ["actor"], "critic": ["critic"]},
            # The environment watches for non-finite values itself, without waiting for the device.
            "check_for_nan": False,
            "torch_compile_mode": "default" if self.torch_compile else None,
            "actor": network | {"distribution_cfg": {"class_name": "GaussianDistribution", "init_std": self.init_std}},
            "critic": dict(network),
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


def require_at_least_one(cfg: AgentCfg, name: str) -> None:
    """Raises a `UserError` unless the field `name` is 1 or more."""
    if getattr(cfg, name) < 1:
        raise UserError(f"agent.{name} {getattr(cfg, name)} must be at least 1.")
