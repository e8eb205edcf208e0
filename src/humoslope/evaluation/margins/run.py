"""A certificate: the searches for the limits of all quantities, and the trials that they ask for."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.deploy.player import Player, Trial, TrialCfg
from humoslope.errors import UserError
from humoslope.evaluation.margins.quantities import Name, Quantity, Success, quantities
from humoslope.evaluation.margins.search import FIRST_LOOK, Rule, Search
from humoslope.evaluation.margins.trials import Job, Key, Setup, TrialRunner, TrialStore, disturbances, fingerprint
from humoslope.interrupts import Interrupt

NOMINAL = "nominal"


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
        self.found = {name: Found(self._search(q)) for name, q in self.quantities.items()}
        self.reference: Series | None = None
        self.store = TrialStore(store_path, fingerprint(folder, model, asdict(nominal) | {"trials": None}))

    def _search(self, quantity: Quantity) -> Search:
        """A search over a grid, whose first value is known to hold only if it is the nominal course."""
        first = quantity.setup(Setup(self._nominal), quantity.grid[0], 0, disturbances(self._nominal.seed, 0))
        return Search(len(quantity.grid), {0: True} if first.cfg == self._nominal else {})

    def setup(self, key: Key) -> Setup:
        """Returns the setup of a trial."""
        name, value, trial = key
        nominal = Setup(self._nominal)
        if name == NOMINAL:
            return nominal
        rng = disturbances(self._nominal.seed, trial)
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
        with TrialRunner(self.store, self._job, processes, interrupt) as runner:
            if not runner.run([self._values(NOMINAL)], lambda asked: on_progress(len(self.store), self._left(asked))):
                return False
            self._check_nominal()
            searches = [self._values(name) for name in self.found]
            return runner.run(searches, lambda asked: on_progress(len(self.store), self._left(asked)))

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

    def _job(self, key: Key) -> Job:
        return Job(self._folder, self._model, self.setup(key), key[2])

    def _left(self, asked: int) -> int:
        # A value fails at the first look, as a rule, or holds at the first one that may show it.
        of_value = (FIRST_LOOK + self._rule.decisive[0]) // 2
        return asked + sum(of_value * found.search.tests_left for found in self.found.values())

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
            "limit": quantity.grid[search.limit] if search.limit >= 0 else None,
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
