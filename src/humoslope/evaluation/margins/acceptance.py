"""The acceptance of a policy: whether it meets what is demanded, from trials in plain MuJoCo."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
from rich.box import SIMPLE_HEAD
from rich.table import Table

from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.deploy.gait import STEP
from humoslope.deploy.player import Player, Trial
from humoslope.evaluation.margins.demands import Case, Demand, Name, demands
from humoslope.evaluation.margins.trials import Job, Key, TrialRunner, TrialStore, fingerprint
from humoslope.interrupts import Interrupt


@dataclass(frozen=True)
class Outcome:
    """Figure of one demand in one case.

    Attributes:
        case: The case.
        falls: Trials that ended in a fall.
        figure: What was measured; NaN if it could not be told.
        met: Whether it lies within the bounds.
    """

    case: Case
    falls: int
    figure: float
    met: bool


class Acceptance:
    """The trials of all demands on an export. Demands that share a case share its trials.

    Args:
        folder: The export folder.
        names: Names of the demands.
        trials: Trials of each case.
        seconds: Length of a trial, s.
        seed: Seed of the random starts and disturbances.
        model: MJCF of another robot with joints of the same names.
        store_path: File of the finished trials.

    Attributes:
        contract: The contract of the export.
        demands: The demands by name.
        cases: All different cases, by a key in words.
        store: Finished trials.

    Raises:
        UserError: If the export or the model cannot be used.
    """

    def __init__(
        self,
        folder: Path,
        names: Iterable[Name],
        trials: int,
        seconds: float,
        seed: int,
        model: Path | None,
        store_path: Path,
    ) -> None:
        self._folder, self._trials, self._model = folder, trials, model
        self.contract: Contract = contracts.read(folder)
        known = demands(seconds, seed)
        self.demands: dict[Name, Demand] = {name: known[name] for name in dict.fromkeys(names)}
        self.cases = {_key(case): case for demand in self.demands.values() for case in demand.cases}
        first = next(iter(self.cases.values())).setup
        Player(folder, self.contract, first.cfg, model=model)  # whatever is wrong with the files is said here
        # Which cases are asked for does not matter to the trials, but what each of them is does: it is in its key.
        self.store = TrialStore(store_path, fingerprint(folder, model, {"seconds": seconds, "seed": seed}))

    def run(
        self, interrupt: Interrupt, processes: int, on_progress: Callable[[int, int], object] = lambda done, left: None
    ) -> bool:
        """Runs the trials that are missing.

        Args:
            interrupt: Request to stop; the trials that run then are still finished and kept.
            processes: Number of processes; 1 runs all trials in this one.
            on_progress: Called with the numbers of trials done and left.

        Returns:
            True if all trials are finished, False if they were interrupted.
        """

        def trials() -> Generator[list[Key], None, None]:
            yield [key for name in self.cases for key in self._keys(name)]

        total = self._trials * len(self.cases)
        with TrialRunner(self.store, self._job, processes, interrupt) as runner:
            return runner.run([trials()], lambda asked: on_progress(total - asked, asked))

    def _keys(self, name: str) -> list[Key]:
        return [(name, 0.0, trial) for trial in range(self._trials)]

    def _job(self, key: Key) -> Job:
        name, _, trial = key
        return Job(self._folder, self._model, self.cases[name].trial(trial), trial)

    def outcomes(self, name: Name) -> list[Outcome]:
        """Returns the figures of a demand in all of its cases, from finished trials."""
        demand, found = self.demands[name], []
        for case in demand.cases:
            trials: list[Trial] = []
            for key in self._keys(_key(case)):
                trial = self.store.get(key)
                assert trial is not None
                trials.append(trial)
            figure = demand.measure(trials, case.setup.cfg)
            found.append(Outcome(case, sum(trial.fell for trial in trials), figure, demand.met(figure)))
        return found

    def report(self) -> dict[str, Any]:
        """Returns all results as JSON types; a function of the trials alone."""
        found = {name: self._describe(name) for name in self.demands}
        return {
            "what": "acceptance",
            "policy": asdict(self.contract.training),
            "network_sha256": self.contract.network.sha256,
            "model": None if self._model is None else str(self._model),
            "mujoco": mujoco.__version__,
            "trials": self._trials,
            "met": all(demand["met"] for demand in found.values()),
            "demands": found,
        }

    def _describe(self, name: Name) -> dict[str, Any]:
        demand, outcomes = self.demands[name], self.outcomes(name)
        worst = max(outcomes, key=lambda outcome: demand.excess(outcome.figure))
        return {
            "meaning": demand.meaning,
            "unit": demand.unit,
            "wanted": demand.wanted,
            "met": all(outcome.met for outcome in outcomes),
            "worst": worst.case.words,
            "cases": {
                outcome.case.words: {
                    "figure": None if math.isnan(outcome.figure) else outcome.figure,
                    "falls": outcome.falls,
                    "met": outcome.met,
                }
                for outcome in outcomes
            },
        }


def _key(case: Case) -> str:
    """A key that differs where a trial would: all of the command, the course and the conditions."""
    cfg = {name: value for name, value in vars(case.setup.cfg).items() if name not in ("trials", "seconds", "seed")}
    changed = vars(case.setup.conditions) | {"imu_tilt": case.imu_tilt}
    return " ".join(f"{name}={value!r}" for name, value in (cfg | changed).items())


def table(report: dict[str, Any]) -> Table:
    """What was demanded, the figure of the worst case, and in how many cases it was met."""
    result = Table(
        title=f"Acceptance of {report['policy']['task']}",
        box=SIMPLE_HEAD,
        collapse_padding=True,
        pad_edge=False,
        caption=f"{report['trials']} trials of each case; {STEP}",
    )
    for column in ("demand", "wanted", "worst", "where", "cases met"):
        result.add_column(column, justify="right" if column in ("worst", "cases met") else "left", overflow="fold")
    for demand in report["demands"].values():
        figure = demand["cases"][demand["worst"]]["figure"]
        met = sum(case["met"] for case in demand["cases"].values())
        shown = "cannot be told" if figure is None else f"{figure:.3g} {demand['unit']}"
        colour = "green" if demand["met"] else "red"
        result.add_row(
            demand["meaning"],
            f"{demand['wanted']} {demand['unit']}",
            f"[{colour}]{shown}[/{colour}]",
            demand["worst"],
            f"{met}/{len(demand['cases'])}",
        )
    return result
