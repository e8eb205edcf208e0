"""A training run: rsl_rl's runner with atomic, complete checkpoints and a clean stop."""

from __future__ import annotations

import random
import signal
import threading
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rsl_rl.runners import OnPolicyRunner

from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.files import write_atomically
from humoslope.learning import checkpoint
from humoslope.learning.config import AgentCfg
from humoslope.learning.logger import TrainingLogger
from humoslope.learning.policy import hidden_dims
from humoslope.learning.symmetry import Mirror, MirrorAugmentation
from humoslope.learning.vec_env import RslRlVecEnv

RELEASE_RATE = 1e-5
"""Learning rate at which a held actor begins to learn: the least that the adaptive rule of rsl_rl's PPO knows, which
raises it within an iteration to what the change of the policy allows. Adam's first step moves every weight by the
learning rate; at 1e-3 that alone threw down an actor that could walk."""


class StopTraining(Exception):
    """Raised between iterations after SIGINT or SIGTERM."""


class Runner(OnPolicyRunner):
    """Trains a task in a run folder.

    Args:
        task: Name of the task, written into checkpoints.
        run_dir: Where curves and checkpoints go; None writes nothing.

    Raises:
        UserError: If a number of `agent` is impossible.
    """

    def __init__(
        self, task: str, env: ManagerBasedRlEnv, agent: AgentCfg, run_dir: Path | None, console: Console
    ) -> None:
        self.task, self.agent, self.run_dir, self._console = task, agent, run_dir, console
        self._manager_env = env
        self._stop = False
        self._ancestor: dict[str, Any] | None = None
        samples = env.num_envs * agent.num_steps_per_env
        if samples < agent.num_mini_batches:
            raise UserError(
                f"agent.num_mini_batches {agent.num_mini_batches} is more than the {samples} samples of a rollout "
                f"({env.num_envs} worlds x {agent.num_steps_per_env} steps)."
            )
        vec_env = RslRlVecEnv(env)
        cfg = agent.to_rsl_rl()
        mirror = Mirror(env) if agent.symmetry else None
        with redirect_stdout(StringIO()):  # it prints the layers of both networks
            super().__init__(vec_env, cfg, None if run_dir is None else str(run_dir), str(env.device))
        if mirror is not None:
            # Set here, and not through rsl_rl's configuration, which could only name rsl_rl's own class.
            self.alg.symmetry = MirrorAugmentation(vec_env, mirror.augment, use_data_augmentation=True)
        self.logger = TrainingLogger(
            env,
            console,
            self._after_iteration,
            log_dir=None if run_dir is None else str(run_dir),
            cfg=self.cfg,
            env_cfg=env.cfg,
            num_envs=env.num_envs,
            is_distributed=self.is_distributed,
            gpu_world_size=self.gpu_world_size,
            gpu_global_rank=self.gpu_global_rank,
            device=self.device,
        )

    def train(self) -> bool:
        """Trains up to the configured number of iterations; SIGINT or SIGTERM saves and ends it early.

        Returns:
            Whether the training is complete.
        """
        left = self.agent.max_iterations - self.current_learning_iteration
        if left <= 0:
            self._console.print(f"Nothing left to do: {self.current_learning_iteration} iterations are done.")
            return True
        # Worlds that all start at once would also end at once,
        # and the learner would see one phase of the episode at a time.
        handlers = self._catch_signals()
        self._hold_actor(self.current_learning_iteration)
        try:
            self.learn(left, init_at_random_ep_len=True)
        except StopTraining:
            self.save(str(self._model_path()))
            self.logger.stop_logging_writer()
            self._console.print(
                f"Stopped after iteration {self.current_learning_iteration + 1}; saved {self._model_path()}."
            )
            return False
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
        return True

    def save(self, path: str, infos: dict[str, Any] | None = None) -> None:
        """Writes a complete checkpoint in one step."""
        state = self.alg.save() | {
            "task": self.task,
            "iter": self.current_learning_iteration,
            "total_steps": self.logger.tot_timesteps,
            "total_time": self.logger.tot_time,
            "env": self._manager_env.state_dict(),
            "ancestor": self._ancestor,
        }
        checkpoint.save(Path(path), state)
        self.logger.save_model(path, self.current_learning_iteration)

    def resume(self, path: Path) -> None:
        """Continues from a checkpoint of the same task: networks, optimiser, curriculum, counters and random numbers.

        Raises:
            UserError: If it cannot be used here.
        """
        state = checkpoint.load(path, self.task, self.device)
        self._load_networks(path, state)
        self.current_learning_iteration = state["iter"] + 1
        self.logger.tot_timesteps, self.logger.tot_time = state["total_steps"], state["total_time"]
        self._ancestor = state.get("ancestor")
        try:
            self._manager_env.load_state_dict(state["env"])
        except KeyError as missing:
            raise UserError(f"checkpoint '{path}' lacks {missing}; another version of the code wrote it.") from None
        checkpoint.restore_rng(state["rng"])

    def warm_start(self, path: Path) -> None:
        """Takes the actor, with its normaliser, from a checkpoint of any task; everything else starts anew.
        Checkpoints of this run will say where they come from.

        Raises:
            UserError: If it cannot be used here.
        """
        state = checkpoint.load(path, device=self.device)
        widths, ours = hidden_dims(path, state["actor_state_dict"]), tuple(self.agent.hidden_dims)
        if widths != ours:
            raise UserError(
                f"the actor of checkpoint '{path}' has hidden layers of {widths}, this run's of {ours}; "
                f"add --agent.hidden-dims {' '.join(map(str, widths))}."
            )
        self._load_networks(path, state, {"actor": True})
        self._ancestor = {
            "path": str(path),
            "sha256": checkpoint.digest(path),
            "task": state["task"],
            "iter": state["iter"],
            "total_steps": state["total_steps"],
            "curriculum": state["env"]["curriculum"],
            "ancestor": state.get("ancestor"),
        }

    def _hold_actor(self, iteration: int) -> None:
        """Decides whether the actor learns in `iteration`. Its normaliser goes on in any case."""
        held = iteration < self.agent.critic_warmup_iterations
        self.alg.actor.requires_grad_(not held)
        # A held actor takes no step to measure: the rule would drive the learning rate by rounding errors alone.
        self.alg.schedule = "fixed" if held else "adaptive"
        if iteration == self.agent.critic_warmup_iterations > 0:
            self.alg.learning_rate = RELEASE_RATE

    def _load_networks(self, path: Path, state: dict[str, Any], parts: dict[str, bool] | None = None) -> None:
        try:
            self.alg.load(state, parts, strict=True)
        except RuntimeError as error:
            detail = str(error).strip().splitlines()[-1].strip()
            raise UserError(f"checkpoint '{path}' does not fit the configured networks: {detail}") from None

    def _model_path(self) -> Path:
        return (self.run_dir or Path()) / f"model_{self.current_learning_iteration}.pt"

    def _after_iteration(self, values: dict[str, float]) -> None:
        for warning in self._manager_env.sim.warnings():
            self._console.print(f"[yellow]physics: {warning}[/yellow]")
        if values.get("Train/diverged", 0.0) > 0.0:
            self._report_divergence()
        if self._stop:
            raise StopTraining
        self._hold_actor(self.current_learning_iteration + 1)

    def _report_divergence(self) -> None:
        states = self._manager_env.take_divergence()
        if states is None or self.run_dir is None:
            return
        qpos, qvel = states
        path = self.run_dir / "diverged" / f"iteration_{self.current_learning_iteration}.npz"
        write_atomically(path, lambda out: np.savez(out, qpos=qpos.numpy(), qvel=qvel.numpy()))
        self._console.print(f"[yellow]A world diverged and was reset; its last states are in {path}.[/yellow]")

    def _catch_signals(self) -> dict[int, Any]:
        if threading.current_thread() is not threading.main_thread():
            return {}

        def stop(number: int, frame: FrameType | None) -> None:
            if self._stop:
                raise KeyboardInterrupt
            self._stop = True
            self._console.print("Stopping after this iteration; once more stops at once, without saving.")

        return {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}


def seed_everything(seed: int) -> None:
    """Seeds Python, NumPy and torch.

    Raises:
        UserError: If NumPy cannot take it.
    """
    if not 0 <= seed < 2**32:
        raise UserError(f"seed {seed} must be at least 0 and below 2^32.")
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - libraries draw from the global generator
    torch.manual_seed(seed)
