"""How a task is learnt: rsl_rl's PPO."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Literal

from humoslope.errors import UserError, unknown
from humoslope.strict import StrictCfg

LOGGERS = ("tensorboard", "wandb")


@dataclass
class AgentCfg(StrictCfg):
    """PPO and its networks; defaults are Unitree RL Lab's where no other source is named.

    Attributes:
        max_iterations: Rollouts to learn from.
        num_steps_per_env: Control steps of a rollout.
        save_interval: Iterations between checkpoints.
        hidden_dims: Layers of actor and critic, both ELU.
        init_std: Standard deviation of the first actions.
        obs_normalization: Whether observations are scaled by their running mean and deviation.
        symmetry: Whether every mini-batch is doubled by its mirror image.
        desired_kl: Step size in policy space that the learning rate is adapted to.
        critic_warmup_iterations: Iterations at the start in which only the critic learns. A new critic's first
            judgements are noise, which would wreck an actor that can walk already.
        logger: Where curves go.
        wandb_project: Project of Weights & Biases, if that is the logger.
        torch_compile: Whether actor and critic are compiled.
        mixed_precision: Whether the update runs in bfloat16; worth it on GPUs and on CPUs with bfloat16 instructions.
    """

    max_iterations: int = 10_000
    num_steps_per_env: int = 24
    save_interval: int = 100
    hidden_dims: tuple[int, ...] = (512, 256, 128)
    init_std: float = 0.8  # measured on the CPU: 1.0 throws the robot over before it learns to stand
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
    max_grad_norm: float = 1.0
    logger: Literal["tensorboard", "wandb"] = "tensorboard"
    wandb_project: str = "humoslope"
    torch_compile: bool = False
    mixed_precision: bool = False

    def to_rsl_rl(self) -> dict[str, Any]:
        """The nested dictionary that rsl_rl's runner reads.

        Raises:
            UserError: If a number is impossible.
        """
        for name in ("max_iterations", "num_steps_per_env", "save_interval", "num_learning_epochs", "num_mini_batches"):
            if getattr(self, name) < 1:
                raise UserError(f"agent.{name} {getattr(self, name)} must be at least 1.")
        if self.critic_warmup_iterations < 0:
            raise UserError(f"agent.critic_warmup_iterations {self.critic_warmup_iterations} must be at least 0.")
        for name in ("init_std", "learning_rate", "desired_kl", "clip_param", "max_grad_norm"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise UserError(f"agent.{name} {getattr(self, name)} must be positive.")
        for name in ("gamma", "lam"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise UserError(f"agent.{name} {getattr(self, name)} must be between 0 and 1.")
        if not self.hidden_dims or min(self.hidden_dims) < 1:
            raise UserError(f"agent.hidden_dims {self.hidden_dims} must be one or more widths of at least 1.")
        if self.logger not in LOGGERS:
            raise unknown("agent.logger", self.logger, LOGGERS)
        if self.logger == "wandb" and find_spec("wandb") is None:
            raise UserError("agent.logger 'wandb' needs a package that is not installed: pip install '.[wandb]'.")
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
            # The environment contains diverged worlds itself, without waiting for the device.
            "check_for_nan": False,
            "torch_compile_mode": "default" if self.torch_compile else None,
            "logger": "tensorboard"
            if self.logger == "tensorboard"
            else {"class_name": "WandbLogWriter", "project_name": self.wandb_project},
            "actor": network | {"distribution_cfg": {"class_name": "GaussianDistribution", "init_std": self.init_std}},
            "critic": dict(network),
            "algorithm": {
                "class_name": "PPO",
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
