"""Trials of an export in several processes, kept on disk as they finish."""

from __future__ import annotations

import hashlib
import json
import math
import multiprocessing
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import mujoco
import numpy as np

from humoslope.deploy import contract as contracts
from humoslope.deploy.conditions import NOMINAL, Conditions
from humoslope.deploy.gait import Gait
from humoslope.deploy.player import Player, Trial, TrialCfg
from humoslope.interrupts import Interrupt, leave_signals_to_parent
from humoslope.seal import read_json, write_json

TRIALS_VERSION = 2
"""Increased when a trial of the same key becomes another one."""
SAVE_EVERY = 16
"""Finished trials between two writes of the file."""
Key = tuple[str, float, int]
"""Name of what is varied, its value, and number of the trial."""


class Setup(NamedTuple):
    """Course, command and conditions of one trial."""

    cfg: TrialCfg
    conditions: Conditions = NOMINAL


@dataclass(frozen=True)
class Job:
    """All that a process needs for a trial.

    Attributes:
        folder: The export folder.
        model: MJCF of another robot; None for the export's own.
        setup: Course, command and conditions.
        trial: Number of the trial, which with the seed decides its random start.
    """

    folder: Path
    model: Path | None
    setup: Setup
    trial: int


def run_job(job: Job) -> Trial:
    """Runs one trial."""
    player = Player(job.folder, contracts.read(job.folder), job.setup.cfg, job.setup.conditions, job.model)
    return player.run_trial(np.random.default_rng((job.setup.cfg.seed, job.trial)))


def disturbances(seed: int, trial: int) -> np.random.Generator:
    """Random numbers of what disturbs a trial, apart from those of its start."""
    return np.random.default_rng((seed, trial, 1))


def random_tilt(angle: float, rng: np.random.Generator) -> tuple[float, float]:
    """Rotation vector by `angle`, rad, about a random horizontal axis; see `Conditions.imu_tilt_rad`."""
    axis = rng.uniform(-math.pi, math.pi)
    return angle * math.cos(axis), angle * math.sin(axis)


def fingerprint(folder: Path, model: Path | None, asked: object) -> str:
    """Hash of all that decides the outcome of a trial beyond its key.

    Args:
        folder: The export folder.
        model: MJCF of another robot; None for the export's own.
        asked: What all trials have in common, as JSON types.
    """
    files = [folder / contracts.FILE] + ([] if model is None else [model])
    hashes = [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
    return hashlib.sha256(json.dumps([TRIALS_VERSION, mujoco.__version__, asked, hashes]).encode()).hexdigest()


class TrialStore:
    """Finished trials in a file. A file of other trials, or a damaged one, is replaced.

    A number of a trial that is NaN, as of one that ended early, is null in the file.

    Args:
        path: The file.
        fingerprint: Hash of all that decides the outcome of a trial beyond its key.
    """

    def __init__(self, path: Path, fingerprint: str) -> None:
        self._path, self._fingerprint, self._unsaved = path, fingerprint, 0
        self._trials: dict[Key, Trial] = {}
        try:
            raw = read_json(path)
            if raw["fingerprint"] == fingerprint:
                self._trials = {(n, float(v), int(i)): _read(fields) for (n, v, i), fields in raw["trials"]}
        except FileNotFoundError:
            pass
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            print(f"'{path}' is damaged ({error}); its trials are run anew.", file=sys.stderr)

    def __len__(self) -> int:
        return len(self._trials)

    def get(self, key: Key) -> Trial | None:
        """Returns a trial; None if it has not been run."""
        return self._trials.get(key)

    def add(self, key: Key, trial: Trial) -> None:
        """Adds a trial and now and then writes the file."""
        self._trials[key] = trial
        self._unsaved += 1
        if self._unsaved >= SAVE_EVERY:
            self.save()

    def save(self) -> None:
        """Writes the file."""
        trials = [[key, _written(trial)] for key, trial in sorted(self._trials.items())]
        write_json(self._path, {"fingerprint": self._fingerprint, "trials": trials})
        self._unsaved = 0


def _written(trial: Trial) -> dict[str, Any]:
    """A trial in JSON types, which have no NaN."""

    def without_nan(fields: dict[str, Any]) -> dict[str, Any]:
        return {
            name: without_nan(value) if isinstance(value, dict) else None if math.isnan(value) else value
            for name, value in fields.items()
        }

    return without_nan(asdict(trial))


def _read(fields: dict[str, Any]) -> Trial:
    """The trial of which `_written` made `fields`."""
    numbers: dict[str, Any] = {name: math.nan if value is None else value for name, value in fields.items()}
    gait: dict[str, Any] = {name: math.nan if value is None else value for name, value in fields["gait"].items()}
    return Trial(**(numbers | {"gait": Gait(**gait)}))


class TrialRunner:
    """Runs the trials that are asked for and missing, in several processes.

    Args:
        store: Store of finished trials.
        job: Function from a key to its job.
        processes: Number of processes; 1 runs all trials in this one.
        interrupt: Request to stop; the trials that run then are still finished and kept.
    """

    def __init__(self, store: TrialStore, job: Callable[[Key], Job], processes: int, interrupt: Interrupt) -> None:
        self._store, self._job, self._processes, self._interrupt = store, job, processes, interrupt
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> TrialRunner:
        if self._processes > 1:
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self._processes, context, leave_signals_to_parent)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
        self._store.save()

    def run(self, searches: Iterable[Generator[list[Key], None, None]], on_progress: Callable[[int], object]) -> bool:
        """Serves searches side by side until all have ended.

        Args:
            searches: Generators that yield the trials that they need next, and go on when all of them are in the store.
            on_progress: Called after each trial with the number of trials that are asked for and not finished.

        Returns:
            False if it was interrupted.
        """
        active = list(searches)
        needs: dict[int, set[Key]] = {}
        waiting: deque[Key] = deque()
        running: dict[Future[Trial], Key] = {}

        def advance(i: int) -> None:
            needs.pop(i, None)
            for keys in active[i]:
                if missing := {key for key in keys if self._store.get(key) is None}:
                    needs[i] = missing
                    waiting.extend(sorted(missing))
                    return

        for i in range(len(active)):
            advance(i)
        while needs and not self._interrupt.requested:
            if self._pool is None:
                finished = [(key := waiting.popleft(), run_job(self._job(key)))]
            else:
                while waiting and len(running) < 2 * self._processes:
                    key = waiting.popleft()
                    running[self._pool.submit(run_job, self._job(key))] = key
                done, _ = wait(running, timeout=0.5, return_when=FIRST_COMPLETED)
                finished = [(running.pop(future), future.result()) for future in done]
            for key, trial in finished:
                self._store.add(key, trial)
                for i in [i for i, missing in needs.items() if key in missing]:
                    needs[i].discard(key)
                    if not needs[i]:
                        advance(i)
            on_progress(len(waiting) + len(running))
        for future, key in running.items():
            if not future.cancel():
                self._store.add(key, future.result())
        return not needs
