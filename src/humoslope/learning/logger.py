"""Curves and console of a training run."""

from __future__ import annotations

import time
from datetime import timedelta
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rsl_rl.utils.logger import Logger
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

if TYPE_CHECKING:
    from collections.abc import Callable

    from humoslope.env import ManagerBasedRlEnv

SHOWN = {
    "reward": "Train/reward",
    "length": "Train/episode_length",
    "falls/s": "Train/falls_per_second",
    "m/s": "Train/speed",
    "harness": "Curriculum/harness",
    "level": "Curriculum/terrain_levels",
}
"""What the progress line shows, besides speed."""


class TrainingLogger(Logger):
    """rsl_rl's logger, fed by the environment's own averages: nothing waits for the device between iterations.

    `after_log` is called at the end of each iteration with the values logged.
    """

    def __init__(
        self, env: ManagerBasedRlEnv, console: Console, after_log: Callable[[dict[str, float]], None], **kwargs: Any
    ) -> None:
        super().__init__(**kwargs)
        self._env, self._console, self._after_log = env, console, after_log
        self._started = time.monotonic()

    def _store_code_state(self) -> list[str]:
        return []  # the run folder tells it already

    def process_env_step(
        self, rewards: Tensor, dones: Tensor, extras: dict[str, Any], intrinsic_rewards: Tensor | None = None
    ) -> None:
        """Gathers the reward; everything else the environment gathers itself."""
        self._env.log.add("Train/reward", rewards / self._env.step_dt)

    def log(
        self,
        it: int,
        start_it: int,
        total_it: int,
        collect_time: float,
        learn_time: float,
        loss_dict: dict[str, float],
        learning_rate: float,
        action_std: Tensor,
        **_: Any,
    ) -> None:
        """Writes the curves of iteration `it`, and a line to the console."""
        steps = self.cfg["num_steps_per_env"] * self.num_envs * self.gpu_world_size
        self.tot_timesteps += steps
        self.tot_time += collect_time + learn_time
        values = self._env.log.flush()
        values |= {f"Loss/{name}": value for name, value in loss_dict.items()}
        values |= {
            "Loss/learning_rate": learning_rate,
            "Policy/mean_std": action_std.mean().item(),
            "Perf/steps_per_second": steps / (collect_time + learn_time),
            "Perf/collection_time": collect_time,
            "Perf/learning_time": learn_time,
            "Perf/total_steps": float(self.tot_timesteps),
            "Perf/total_time": self.tot_time,
        }
        if self.writer is not None:
            for name, value in values.items():
                self.writer.add_scalar(name, value, it)
            self._print(it, start_it, total_it, values)
        self._after_log(values)

    def save_model(self, path: str, it: int) -> None:
        """Puts the curves up to a checkpoint on the disk together with it,
        so that a killed run resumes without a gap."""
        super().save_model(path, it)
        if isinstance(self.writer, SummaryWriter):
            self.writer.flush()

    def stop_logging_writer(self) -> None:
        """Writes what is left of the curves."""
        super().stop_logging_writer()
        if isinstance(self.writer, SummaryWriter):
            self.writer.close()

    def _print(self, it: int, start_it: int, total_it: int, values: dict[str, float]) -> None:
        per_iteration = (time.monotonic() - self._started) / (it + 1 - start_it)
        left = timedelta(seconds=int(per_iteration * (total_it - it - 1)))
        shown = "  ".join(f"{label} {values[key]:.3g}" for label, key in SHOWN.items() if key in values)
        self._console.print(
            f"[bold]{it + 1}/{total_it}[/bold]  {self.tot_timesteps / 1e6:.2f} M steps  "
            f"{values['Perf/steps_per_second']:,.0f}/s  {shown}  std {values['Policy/mean_std']:.2f}  left {left}",
            highlight=False,
        )
