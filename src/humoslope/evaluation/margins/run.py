"""Trials of a certificate in several processes, kept on disk as they finish, and the searches that they serve."""

from __future__ import annotations

import hashlib
import json
import math
import multiprocessing
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.deploy.player import Player, Trial, TrialCfg
from humoslope.errors import UserError
from humoslope.evaluation.margins.quantities import Name, Quantity, Setup, Success, quantities
from humoslope.evaluation.margins.search import FIRST_LOOK, Rule, Search
from humoslope.interrupts import Interrupt, leave_signals_to_parent
from humoslope.seal import read_json, write_json

TRIALS_VERSION = 1
"""Increased when a trial of the same key becomes another one."""
NOMINAL = "nominal"
SAVE_EVERY = 16
"""Finished trials between two writes of the file."""
Key = tuple[str, float, int]
"""Name of the quantity, its value, and number of the trial."""


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
    return {name: None if math.isnan(value) else value for name, value in vars(trial).items()}


def _read(fields: dict[str, Any]) -> Trial:
    """The trial of which `_written` made `fields`."""
    numbers: dict[str, Any] = {name: math.nan if value is None else value for name, value in fields.items()}
    return Trial(**numbers)


@dataclass
class Series:
    """Trials of one value.

    Attributes:
        value: Value of the quantity.
        trials: Finished trials in the order of their numbers.
        successes: Number of them that succeeded.
        holds: Whether the required share was shown.
    """

    value: float
    trials: list[Trial]
    successes: int
    holds: bool


@dataclass
class Found:
    """Result for one quantity.

    Attributes:
        search: Outcomes by index of the grid.
        series: Trials by index of the grid.
    """

    search: Search
    series: dict[int, Series] = field(default_factory=dict)


class Certificate:
    """All searches for an export.

    Args:
        folder: The export folder.
        nominal: Course and command of all trials, before a quantity is varied.
        names: Names of the quantities.
        rule: Rule by which values are judged.
        success: Definition of a successful trial.
        model: MJCF of another robot with joints of the same names.
        store_path: File of the finished trials.

    Attributes:
        contract: The contract of the export.
        quantities: The quantities by name.
        found: Results by name; partial while `run` is under way.
        reference: Trials under nominal conditions; None before they are finished.

    Raises:
        UserError: If the export or the model cannot be used.
    """

    def __init__(
        self,
        folder: Path,
        nominal: TrialCfg,
        names: Iterable[Name],
        rule: Rule,
        success: Success,
        model: Path | None,
        store_path: Path,
    ) -> None:
        self._folder, self._nominal, self._rule, self._success, self._model = folder, nominal, rule, success, model
        self.contract: Contract = contracts.read(folder)
        Player(folder, self.contract, nominal, model=model)  # whatever is wrong with the files is said here
        known = quantities(self.contract, nominal)
        self.quantities: dict[Name, Quantity] = {name: known[name] for name in dict.fromkeys(names)}
        self.found = {name: Found(Search(len(q.grid))) for name, q in self.quantities.items()}
        self.reference: Series | None = None
        self.store = TrialStore(store_path, self._fingerprint())
        self._successes: dict[Key, bool] = {}

    def _fingerprint(self) -> str:
        other = None if self._model is None else hashlib.sha256(self._model.read_bytes()).hexdigest()
        cfg = asdict(self._nominal) | {"trials": None}
        files = [hashlib.sha256((self._folder / contracts.FILE).read_bytes()).hexdigest(), other]
        return hashlib.sha256(json.dumps([TRIALS_VERSION, mujoco.__version__, cfg, files]).encode()).hexdigest()

    def setup(self, key: Key) -> Setup:
        """Returns the setup of a trial."""
        name, value, trial = key
        nominal = Setup(self._nominal)
        if name == NOMINAL:
            return nominal
        rng = np.random.default_rng((self._nominal.seed, trial, 1))
        return self.quantities[name].setup(nominal, value, trial, rng)  # type: ignore[index]

    def run(
        self,
        interrupt: Interrupt,
        processes: int,
        on_progress: Callable[[int, int], object] = lambda done, left: None,
    ) -> bool:
        """Runs the trials that are missing.

        Args:
            interrupt: Request to stop; the trials that run then are still finished and kept.
            processes: Number of processes; 1 runs all trials in this one.
            on_progress: Called with the numbers of trials done and, by estimate, left.

        Returns:
            True if all searches are finished, False if they were interrupted.

        Raises:
            UserError: If the policy does not succeed under nominal conditions.
        """
        pool = None
        if processes > 1:
            pool = ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"), leave_signals_to_parent)
        try:
            if not self._drive([self._values(NOMINAL)], pool, processes, interrupt, on_progress):
                return False
            self._check_nominal()
            return self._drive([self._values(n) for n in self.found], pool, processes, interrupt, on_progress)
        finally:
            if pool is not None:
                pool.shutdown(cancel_futures=True)
            self.store.save()

    def _values(self, name: Name | str) -> Generator[list[Key], None, None]:
        """Searches for the limit of a quantity; yields trials, all of which are finished when it goes on."""
        if name == NOMINAL:
            self.reference = yield from self._judge(NOMINAL, 0.0)
            return
        found, grid = self.found[name], self.quantities[name].grid  # type: ignore[index]
        steps = found.search.run()
        index = next(steps, None)
        while index is not None:
            found.series[index] = series = yield from self._judge(name, grid[index])
            try:
                index = steps.send(series.holds)
            except StopIteration:
                index = None

    def _judge(self, name: str, value: float) -> Generator[list[Key], None, Series]:
        holds, trials, successes = None, 0, 0
        for trials in self._rule.looks:
            keys = [(name, value, trial) for trial in range(trials)]
            yield keys
            successes = sum(self._success(self._finished(key), self.setup(key).cfg) for key in keys)
            holds = self._rule.judge(successes, trials)
            if holds is not None:
                break
        return Series(value, [self._finished((name, value, i)) for i in range(trials)], successes, bool(holds))

    def _finished(self, key: Key) -> Trial:
        trial = self.store.get(key)
        assert trial is not None
        return trial

    def _drive(
        self,
        searches: list[Generator[list[Key], None, None]],
        pool: ProcessPoolExecutor | None,
        processes: int,
        interrupt: Interrupt,
        on_progress: Callable[[int, int], object],
    ) -> bool:
        """Runs the trials that the searches ask for, side by side; returns False if it was interrupted."""
        needs: dict[int, set[Key]] = {}
        waiting: deque[Key] = deque()
        running: dict[Future[Trial], Key] = {}

        def advance(i: int) -> None:
            needs.pop(i, None)
            for keys in searches[i]:
                if missing := {key for key in keys if self.store.get(key) is None}:
                    needs[i] = missing
                    waiting.extend(sorted(missing))
                    return

        for i in range(len(searches)):
            advance(i)
        while needs and not interrupt.requested:
            if pool is None:
                finished = [(key := waiting.popleft(), run_job(self._job(key)))]
            else:
                while waiting and len(running) < 2 * processes:
                    key = waiting.popleft()
                    running[pool.submit(run_job, self._job(key))] = key
                done, _ = wait(running, timeout=0.5, return_when=FIRST_COMPLETED)
                finished = [(running.pop(future), future.result()) for future in done]
            for key, trial in finished:
                self.store.add(key, trial)
                for i in [i for i, missing in needs.items() if key in missing]:
                    needs[i].discard(key)
                    if not needs[i]:
                        advance(i)
            on_progress(len(self.store), self._left(len(waiting) + len(running)))
        for future, key in running.items():
            if not future.cancel():
                self.store.add(key, future.result())
        return not needs

    def _job(self, key: Key) -> Job:
        return Job(self._folder, self._model, self.setup(key), key[2])

    def _left(self, asked: int) -> int:
        return asked + sum(2 * FIRST_LOOK * found.search.tests_left for found in self.found.values())

    def _check_nominal(self) -> None:
        assert self.reference is not None
        if self.reference.holds:
            return
        trials, falls = len(self.reference.trials), sum(trial.fell for trial in self.reference.trials)
        raise UserError(
            f"export '{self._folder}' succeeds in {self.reference.successes} of {trials} trials under nominal "
            f"conditions, and falls in {falls}; there is no margin to certify where "
            f"{100.0 * self._rule.share:g} % is not shown ({self._success})."
        )

    def report(self) -> dict[str, Any]:
        """Returns all results as JSON types; a function of the trials alone."""
        assert self.reference is not None
        return {
            "what": "margins",
            "policy": asdict(self.contract.training),
            "network_sha256": self.contract.network.sha256,
            "model": None if self._model is None else str(self._model),
            "mujoco": mujoco.__version__,
            "nominal": {k: v for k, v in asdict(self._nominal).items() if k != "trials"},
            "rule": asdict(self._rule),
            "success": str(self._success),
            "reference": self._describe(self.reference),
            "quantities": {name: self._describe_quantity(name) for name in self.found},
        }

    def _describe_quantity(self, name: Name) -> dict[str, Any]:
        quantity, found = self.quantities[name], self.found[name]
        search = found.search
        return {
            "meaning": quantity.meaning,
            "unit": quantity.unit,
            "nominal": quantity.grid[0],
            "limit": quantity.grid[search.limit],
            "first_failing": quantity.grid[search.failing] if search.failing < search.size else None,
            "monotone": search.monotone,
            "grid": list(quantity.grid),
            "tested": [self._describe(found.series[i]) for i in sorted(found.series)],
        }

    def _describe(self, series: Series) -> dict[str, Any]:
        n = len(series.trials)
        lasted = [trial.speed for trial in series.trials if not np.isnan(trial.speed)]
        return {
            "value": series.value,
            "holds": series.holds,
            "trials": n,
            "successes": series.successes,
            "falls": sum(trial.fell for trial in series.trials),
            "share_at_least": self._rule.lower(series.successes, n),
            "mean_speed": float(np.mean(lasted)) if lasted else None,
        }
