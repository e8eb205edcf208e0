"""rsl_rl's PPO as a learner: its runner builds networks, storage and algorithm; the training loop drives them."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO
from itertools import pairwise
from math import prod
from typing import Any

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.extensions import Symmetry
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict
from torch import Tensor

from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.learning.config import PpoCfg
from humoslope.learning.distributed import read_processes
from humoslope.learning.learner import Transition
from humoslope.learning.policy import PolicySpec, shapes_of
from humoslope.learning.symmetry import Mirror
from humoslope.learning.vec_env import RslRlVecEnv
from humoslope.memory import require_memory

RELEASE_RATE = 1e-5
"""Learning rate at which a held actor begins to learn: the least that the adaptive rule of rsl_rl's PPO knows, which
raises it within an iteration to what the change of the policy allows. Adam's first step moves every weight by the
learning rate; at 1e-3 that alone threw down an actor that could walk."""


class PpoLearner(OnPolicyRunner):
    """rsl_rl's `OnPolicyRunner` without its loop: `learn`, logging and saving are the trainer's.

    Raises:
        UserError: If a value of the configuration is impossible, or does not fit the environment.
    """

    alg: WarmStartPpo
    wants_terminal_obs = False

    def __init__(self, env: ManagerBasedRlEnv, cfg: PpoCfg) -> None:
        self._agent = cfg
        rsl_rl_cfg = cfg.to_rsl_rl()
        samples = env.num_envs * cfg.num_steps_per_env
        if samples < cfg.num_mini_batches:
            raise UserError(
                f"agent.num_mini_batches {cfg.num_mini_batches} is more than the {samples} samples of a rollout "
                f"({env.num_envs} envs x {cfg.num_steps_per_env} steps)."
            )
        rsl_rl_cfg["actor"] |= (settings := cfg.network_settings(env))
        rsl_rl_cfg["critic"] |= settings
        actor_groups = tuple(rsl_rl_cfg["obs_groups"]["actor"])
        read = {name for names in rsl_rl_cfg["obs_groups"].values() for name in names}
        width = sum(map(prod, shapes_of(env, tuple(sorted(read))))) + 4 * env.robot.num_joints
        if env.device.type == "cpu":
            rollout = 4 * cfg.num_steps_per_env * width
            batch = rollout * (2 if cfg.symmetry else 1) / cfg.num_mini_batches
            require_memory("env.num_envs", env.num_envs, rollout + batch, f" with rollouts of {cfg.num_steps_per_env}")
            layers = (cfg.hidden_dims, cfg.critic_hidden_dims or cfg.hidden_dims)
            weights = sum(a * b for dims in layers for a, b in pairwise((width, *dims, env.robot.num_joints)))
            # With gradients and two moments of Adam, in single precision.
            require_memory("the number of the networks' weights", weights, 4 * 4)
        if cfg.symmetry:
            augment = Mirror(env).augment
            rsl_rl_cfg["algorithm"]["symmetry_cfg"] = {
                "data_augmentation_func": augment,
                "use_data_augmentation": True,
            }
        with redirect_stdout(StringIO()):  # it prints the layers of both networks
            super().__init__(RslRlVecEnv(env), rsl_rl_cfg, None, str(env.device))
        network = {name: value for name, value in rsl_rl_cfg["actor"].items() if name != "class_name"}
        self.spec = PolicySpec.of(env, cfg.network, actor_groups, network)
        self.policy = self.alg.get_policy()
        self.alg.train_mode()

    def begin(self, iteration: int) -> None:
        """Sets the entropy bonus, and whether the actor learns in this iteration. Its normaliser learns in any case."""
        agent = self._agent
        if agent.final_entropy_coef is not None:
            share = min(1.0, iteration / max(1, agent.max_iterations - 1))
            self.alg.entropy_coef = agent.entropy_coef + share * (agent.final_entropy_coef - agent.entropy_coef)
        warmup = agent.critic_warmup_iterations
        self.alg.hold_actor(iteration < warmup)
        if iteration == warmup > 0:
            self.alg.learning_rate = RELEASE_RATE

    def act(self, obs: TensorDict) -> Tensor:
        """A sampled action [N, J]."""
        return self.alg.act(obs)

    def take(self, transition: Transition) -> None:
        """Puts a step into the rollout; time-outs are bootstrapped by rsl_rl, with the value before the step."""
        self.alg.process_env_step(
            transition.next_obs,
            transition.reward,
            transition.done.to(torch.int64),
            {"time_outs": transition.time_outs},
        )

    def update(self, obs: TensorDict) -> dict[str, float]:
        """PPO's epochs over the rollout."""
        with torch.inference_mode():
            self.alg.compute_returns(obs)
        losses = self.alg.update()
        return {
            **{f"Loss/{name}": value for name, value in losses.items()},
            "Loss/learning_rate": self.alg.learning_rate,
            "Policy/mean_std": self.alg.get_policy().output_std.mean().item(),
        }

    def synchronise(self) -> None:
        """Gives every process the weights of the first one."""
        if self.is_distributed:
            self.alg.broadcast_parameters()

    def remarks(self) -> list[str]:
        """Nothing to remark."""
        return []

    def state_dict(self) -> dict[str, Any]:
        """Critic and optimiser."""
        state = self.alg.save()
        return {name: state[name] for name in ("critic_state_dict", "optimizer_state_dict")}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict`; the learning rate is the optimiser's."""
        self.alg.load(state, {"critic": True, "optimizer": True}, strict=True)

    def _configure_multi_gpu(self) -> None:
        """Tells rsl_rl of the other processes. The trainer has connected them already, between CPUs by gloo, where
        rsl_rl itself knows only nccl."""
        processes = read_processes()
        self.gpu_world_size, self.is_distributed = processes.size, processes.size > 1
        self.gpu_global_rank, self.gpu_local_rank = processes.rank, processes.local_rank
        self.cfg["multi_gpu"] = (
            {"global_rank": processes.rank, "local_rank": processes.local_rank, "world_size": processes.size}
            if self.is_distributed
            else None
        )


class WarmStartPpo(PPO):
    """PPO whose actor can be held still while a new critic learns, and whose mirror images cost no second pass."""

    def __init__(self, *args: Any, symmetry_cfg: dict[str, Any] | None = None, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        if symmetry_cfg is not None:
            self.symmetry = MirrorAugmentation(**symmetry_cfg)

    def hold_actor(self, held: bool) -> None:
        """Stops or resumes learning of the actor.

        A held actor takes no step whose size could be measured: the adaptive rule would follow rounding errors alone.
        """
        self.actor.requires_grad_(not held)
        self.schedule = "fixed" if held else "adaptive"


class MirrorAugmentation(Symmetry):
    """rsl_rl's augmentation without a second pass through the actor,
    whose answer to the doubled batch is already known."""

    def compute_loss(self, actor: torch.nn.Module, batch: object, original_batch_size: int) -> Tensor:
        """Mean squared difference between the means of mirrored observations and the mirrored means, for the log."""
        means = actor.output_mean.detach()  # type: ignore[operator]
        _, mirrored = self.data_augmentation_func(env=self.env, obs=None, actions=means[:original_batch_size])
        return torch.nn.functional.mse_loss(means[original_batch_size:], mirrored[original_batch_size:])
