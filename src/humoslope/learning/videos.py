"""Videos of a training at intervals, drawn by a process of the lowest priority while training goes on."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from humoslope.interrupts import die_with_parent

FOLDER = "videos"
"""Folder of the videos in a run folder."""
MODULE = "humoslope.cli.interval_video"
"""What the process runs."""


class IntervalVideos:
    """An `Onlooker` of a training that starts a process for a video every so many iterations.

    There is one process at a time: a video that would be due while the one before is still being drawn is left out.

    Args:
        run_dir: The run folder.
        every: Iterations between two videos.
        save: Writes a checkpoint of the present weights to a path.
    """

    def __init__(self, run_dir: Path, every: int, save: Callable[[Path], object], console: Console) -> None:
        self._folder, self._every, self._save, self._console = run_dir / FOLDER, every, save, console
        self._process: subprocess.Popen[bytes] | None = None
        self._video = Path()

    def after_step(self) -> None:
        """Nothing to do."""

    def after_iteration(self, iteration: int, values: dict[str, float]) -> None:
        """Starts a video if it is time for one, and says what became of the last one."""
        self._report()
        if (iteration + 1) % self._every:
            return
        if self._process is not None:
            self._console.print(
                f"[yellow]No video of iteration {iteration + 1}: the one before is still being drawn.[/yellow]"
            )
            return
        self._video = self._folder / f"iteration_{iteration + 1}.mp4"
        checkpoint = self._video.with_suffix(".pt")  # the process removes it
        self._save(checkpoint)
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", MODULE, str(checkpoint), str(self._video)],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=os.environ | {"OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""},
                start_new_session=True,  # Ctrl-C in the terminal is for training
                preexec_fn=die_with_parent,  # noqa: PLW1509 - only calls functions of the C library
            )

    def close(self, finished: bool) -> None:
        """Waits for the last video if training is complete, and gives it up otherwise."""
        if self._process is None:
            return
        if finished:
            self._console.print(f"Waiting for {self._video}; Ctrl-C gives it up.", soft_wrap=True)
            self._process.wait()
        else:
            self._process.terminate()
            self._process.wait()
        self._report()

    @property
    def _log(self) -> Path:
        return self._folder / "log.txt"

    def _report(self) -> None:
        if self._process is None or self._process.poll() is None:
            return
        if self._process.returncode == 0:
            self._console.print(f"wrote {self._video}", soft_wrap=True)
        elif self._process.returncode > 0:
            self._console.print(f"[yellow]{self._video} was not drawn; {self._log} says why.[/yellow]", soft_wrap=True)
        self._process = None
