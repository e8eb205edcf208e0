"""Curves and progress line of a training run."""

from __future__ import annotations

import re
import time
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rich.console import Console

from humoslope.errors import UserError
from humoslope.provenance import plain

if TYPE_CHECKING:
    from humoslope.registry import TaskCfg

SHOWN = {
    "reward": "Train/reward",
    "length": "Train/episode_length",
    "falls/s": "Train/falls_per_second",
    "m/s": "Train/speed",
    "harness": "Curriculum/harness",
    "skills": "Curriculum/skills",
    "level": "Curriculum/terrain_levels",
    "std": "Policy/mean_std",
}
"""Curves in the progress line, besides the speed of training, by their short names."""


class CurveWriter:
    """Writes curves to event files of TensorBoard, and to Weights & Biases if the agent asks for it.

    Args:
        folder: Folder of the event files; None writes nothing.
        cfg: Configuration of the run; Weights & Biases gets it too.

    Raises:
        UserError: If Weights & Biases refuses, as without a login.
    """

    def __init__(self, folder: Path | None, cfg: TaskCfg) -> None:
        self._folder = folder
        self._writer: Any = None
        if folder is None:
            return
        if cfg.agent.logger == "wandb":
            self._writer = _wandb_writer(folder, cfg)
        else:
            self.renew()

    def renew(self) -> None:
        """Begins a new event file, as when the folder with the old one was removed."""
        if self._folder is not None and not hasattr(self._writer, "save_model"):
            from torch.utils.tensorboard import SummaryWriter

            self._writer = SummaryWriter(log_dir=str(self._folder), flush_secs=10)

    def write(self, iteration: int, values: dict[str, float]) -> None:
        """Adds a point to each curve."""
        if self._writer is not None:
            for name, value in values.items():
                self._writer.add_scalar(name, value, iteration)

    def flush(self) -> None:
        """Puts the curves on the disk, so that a killed run resumes from a checkpoint without a gap in them."""
        if self._writer is not None:
            self._writer.flush()

    def upload(self, checkpoint: Path, iteration: int) -> None:
        """Sends a checkpoint to Weights & Biases, if curves go there."""
        if hasattr(self._writer, "save_model"):
            self._writer.save_model(str(checkpoint), iteration)

    def close(self) -> None:
        """Writes what is left."""
        if self._writer is not None:
            self._writer.close()
            if hasattr(self._writer, "stop"):
                self._writer.stop()


def _wandb_writer(folder: Path, cfg: TaskCfg) -> Any:
    import wandb
    from rsl_rl.utils.wandb_log_writer import WandbLogWriter

    try:
        writer = WandbLogWriter(str(folder), cfg.agent.wandb_project)
    except Exception as error:  # of wandb's own kinds
        said = next(iter(str(error).splitlines()), type(error).__name__).rstrip(".")
        raise UserError(
            f"Weights & Biases does not begin: {said}; log in with 'wandb login', or set WANDB_MODE=offline."
        ) from None
    wandb.config.update({"env": plain(cfg.env), "agent": plain(cfg.agent)})
    return writer


class ProgressLine:
    """A line on the console for every iteration, with the time left.

    Args:
        first, last: The first iteration of this start, and the number after the last one.
    """

    def __init__(self, console: Console, first: int, last: int) -> None:
        self._console, self._first, self._last = console, first, last
        self._started = time.monotonic()

    def show(self, iteration: int, values: dict[str, float]) -> None:
        """Prints the line of an iteration that has ended."""
        per_iteration = (time.monotonic() - self._started) / (iteration + 1 - self._first)
        left = timedelta(seconds=int(per_iteration * (self._last - iteration - 1)))
        shown = "  ".join(f"{label} {values[key]:.3g}" for label, key in SHOWN.items() if key in values)
        self._console.print(
            f"[bold]{iteration + 1}/{self._last}[/bold]  {values['Perf/total_steps'] / 1e6:.2f} M steps  "
            f"{values['Perf/steps_per_second']:,.0f}/s  {shown}  left {left}",
            highlight=False,
        )


class Line(NamedTuple):
    """What a line of `ProgressLine` tells: iterations that are done, and environment steps per second in the last."""

    iteration: int
    speed: float


def read_line(text: str) -> Line | None:
    """Reads a line of `ProgressLine`; None if it is another one."""
    found = re.match(r"(\d+)/\d+  [\d.]+ M steps  ([\d,]+)/s  ", text)
    return None if found is None else Line(int(found[1]), float(found[2].replace(",", "")))
