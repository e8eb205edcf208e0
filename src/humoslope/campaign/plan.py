"""From a campaign's file to its jobs, in an order in which each finds what the earlier ones left.

A job is one command as a user would type it: `humoslope train`, `calibrate`, `evaluate` or `ramps`. Everything of a row
at one seed lies in its run folder, FOLDER/ROW/seedN.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Literal

from humoslope.campaign.file import CALIBRATE, PRIOR, TRAIN, Campaign, Evaluation, Training
from humoslope.errors import UserError


@dataclass(frozen=True)
class Scale:
    """What a plan needs to know of a task with its options.

    Attributes:
        num_envs: Number of envs.
        samples: Environment steps of an iteration.
        save_interval: Iterations between two checkpoints.
        preset: Scale that "auto" stands for on this machine.
        start: Task that it goes on from; "" if it can start from nothing.
        calibrated: Reward that the swing calibration of its parent sets; "" for none.
    """

    num_envs: int
    samples: int
    save_interval: int
    preset: str
    start: str = ""
    calibrated: str = ""


@dataclass(frozen=True)
class Job:
    """One command of a campaign.

    Attributes:
        row, seed: Training that it belongs to.
        column: `TRAIN`, `CALIBRATE`, or the name of an evaluation.
        verb: Verb of the command.
        folder: Run folder of the row at this seed.
        words: Command after the verb; of a training, that of a new run.
        result: File that is there once it is done.
        needs: Names of the jobs that must be done before.
        iterations: Iterations of the training, or of the training whose result it reads.
        scale: Scale of that training.
        parent: Checkpoint that the training starts from; None for none.
    """

    row: str
    seed: int
    column: str
    verb: Literal["train", "calibrate", "evaluate", "ramps"]
    folder: Path
    words: tuple[str, ...]
    result: Path
    needs: tuple[str, ...]
    iterations: int
    scale: Scale
    parent: Path | None = None

    @property
    def name(self) -> str:
        """Name, such as "full/seed2 track"."""
        return job_name(self.row, self.seed, self.column)

    @property
    def steps(self) -> int:
        """Environment steps of the training."""
        return self.iterations * self.scale.samples


Resolve = Callable[[str, Literal["auto", "cpu", "gpu"], Sequence[str]], Scale]
"""Gives the scale of a task with a preset and options."""


def job_name(row: str, seed: int, column: str) -> str:
    """Name of a job."""
    return f"{row}/seed{seed} {column}"


@dataclass(frozen=True)
class Plan:
    """Jobs of a campaign by name, in an order in which they can run.

    Attributes:
        campaign: The campaign.
        folder: Folder of everything that it makes.
        jobs: Jobs; those of the first seed of every row first, as far as their parents allow.
        walks: Environment steps of one evaluation by its name, if all its trials succeed at the commanded speed.
    """

    campaign: Campaign
    folder: Path
    jobs: dict[str, Job]
    walks: dict[str, int]


def make_plan(
    campaign: Campaign,
    folder: Path,
    resolve: Resolve,
    check: Callable[[Evaluation], int] = lambda evaluation: 0,
) -> Plan:
    """The jobs of a campaign.

    Args:
        folder: Folder of everything that it makes.
        resolve: Gives the scale of a task; raises UserError if it does not accept an option.
        check: Gives the environment steps of an evaluation; raises UserError if its options are impossible.

    Raises:
        UserError: If something in the file cannot be; the sentence names the key.
    """
    walks = {}
    for evaluation in campaign.evaluations.values():
        with _naming(campaign, f"evaluate.{evaluation.name}"):
            walks[evaluation.name] = check(evaluation)
    return Plan(campaign, folder, _Planner(campaign, folder, resolve).jobs(), walks)


class _Planner:
    def __init__(self, campaign: Campaign, folder: Path, resolve: Resolve) -> None:
        self._campaign, self._folder = campaign, folder
        self._scales: dict[str, Scale] = {}
        for row in campaign.trainings.values():
            with _naming(campaign, f"train.{row.name}"):
                self._scales[row.name] = resolve(row.task, campaign.preset, row.options)
        for row in campaign.trainings.values():
            self._check_parent(row)

    def jobs(self) -> dict[str, Job]:
        jobs: dict[str, Job] = {}
        rows = self._campaign.trainings
        calibrated = {(row.parent, seed) for row in rows.values() if self._calibrates(row) for seed in row.seeds}
        for row in rows.values():
            for seed in row.seeds:
                training = self._training(row, seed)
                wanted = [training]
                if (row.name, seed) in calibrated:
                    wanted.append(self._calibration(training))
                wanted += [
                    self._evaluation(training, evaluation)
                    for evaluation in self._campaign.evaluations.values()
                    if row.name in evaluation.of
                ]
                jobs |= {job.name: job for job in wanted}
        return _in_order(jobs, {name: rows[job.row].seeds.index(job.seed) for name, job in jobs.items()})

    def iterations(self, row: Training) -> int:
        return row.iterations or math.ceil(row.steps / self._scales[row.name].samples)

    def _training(self, row: Training, seed: int) -> Job:
        folder = self._run_folder(row.name, seed)
        iterations, scale, needs = self.iterations(row), self._scales[row.name], []
        parent = row.checkpoint
        if row.parent:
            parent = self._parent_checkpoint(row, seed)
            needs.append(job_name(row.parent, seed, CALIBRATE if self._calibrates(row) else TRAIN))
        start: list[str] = [] if parent is None else ["--init", str(parent)]
        if row.calibration:
            start += ["--calibration", row.calibration]
        words = [row.task, "--run-dir", str(folder), "--preset", self._campaign.preset, *row.options]
        words += ["--env.seed", str(seed), "--agent.max-iterations", str(iterations), *start]
        result = _checkpoint(folder, iterations - 1)
        return Job(
            row.name, seed, TRAIN, "train", folder, tuple(words), result, tuple(needs), iterations, scale, parent
        )

    def _calibration(self, training: Job) -> Job:
        # One for all children: of the last checkpoint, as only a row without calibration may start from an earlier one.
        result = training.result.with_suffix(".swing.json")
        words = (str(training.result), "--out", str(result), *self._campaign.calibrate)
        return _after(training, CALIBRATE, "calibrate", words, result)

    def _evaluation(self, training: Job, evaluation: Evaluation) -> Job:
        result = training.folder / f"{evaluation.name}.json"
        ramps = evaluation.kind == "ramps"
        out = str(result if ramps else result.with_suffix(""))
        words = (str(training.result), "--out", out, *evaluation.words)
        return _after(training, evaluation.name, "ramps" if ramps else "evaluate", words, result)

    def _check_parent(self, row: Training) -> None:
        scale, at = self._scales[row.name], f"train.{row.name}"
        if scale.start and not row.parent and row.checkpoint is None:
            raise _mistake(self._campaign, at, f"needs a 'parent' that trains {scale.start}, or a checkpoint of it")
        if row.calibration and not scale.calibrated:
            raise _mistake(self._campaign, f"{at}.calibration", f"has no effect: {row.task} has no calibrated reward")
        if row.checkpoint is not None and scale.calibrated and not row.calibration:
            beside = row.checkpoint.with_suffix(".swing.json")
            if not beside.is_file():
                said = f"has no swing calibration '{beside}'; name one under 'calibration', or \"{PRIOR}\""
                raise _mistake(self._campaign, f"{at}.parent", said)
        if not row.parent:
            return
        parent = self._campaign.trainings[row.parent]
        if scale.start and parent.task != scale.start:
            said = f"is '{row.parent}', which trains {parent.task}; {row.task} starts from {scale.start}"
            raise _mistake(self._campaign, f"{at}.parent", said)
        earlier, last = row.parent_iteration, self.iterations(parent) - 1
        if earlier is None:
            return
        every = self._scales[row.parent].save_interval
        if earlier > last or (earlier % every and earlier != last):
            said = f"is {earlier}; '{row.parent}' has a checkpoint every {every} iterations from 0 on, and at {last}"
            raise _mistake(self._campaign, f"{at}.parent-iteration", said)
        if self._calibrates(row) and earlier != last:
            said = "needs a 'calibration': only a parent's last checkpoint is calibrated"
            raise _mistake(self._campaign, f"{at}.parent-iteration", said)

    def _calibrates(self, row: Training) -> bool:
        """True if the swing calibration of the parent is needed."""
        return bool(row.parent and self._scales[row.name].calibrated and not row.calibration)

    def _parent_checkpoint(self, row: Training, seed: int) -> Path:
        parent = self._campaign.trainings[row.parent]
        last = self.iterations(parent) - 1 if row.parent_iteration is None else row.parent_iteration
        return _checkpoint(self._run_folder(parent.name, seed), last)

    def _run_folder(self, row: str, seed: int) -> Path:
        return self._folder / row / f"seed{seed}"


def _after(
    training: Job, column: str, verb: Literal["calibrate", "evaluate", "ramps"], words: tuple[str, ...], result: Path
) -> Job:
    needs = (training.name,)
    return Job(
        training.row, training.seed, column, verb, training.folder, words, result, needs, training.iterations,
        training.scale,
    )  # fmt: skip


def _in_order(jobs: Mapping[str, Job], turn: Mapping[str, int]) -> dict[str, Job]:
    """The jobs so that each comes after those it needs: the first seed of every row first, then in the file's order."""
    place = {name: i for i, name in enumerate(jobs)}
    sorter = TopologicalSorter({name: job.needs for name, job in jobs.items()})
    sorter.prepare()
    ordered: dict[str, Job] = {}
    ready: list[str] = []
    while sorter.is_active():
        ready += sorter.get_ready()
        # What comes of a training that is done is wanted before another training.
        ready.sort(key=lambda name: (turn[name], jobs[name].column == TRAIN, place[name]))
        name = ready.pop(0)
        ordered[name] = jobs[name]
        sorter.done(name)
    return ordered


def _checkpoint(folder: Path, iteration: int) -> Path:
    return folder / f"model_{iteration}.pt"


def _mistake(campaign: Campaign, key: str, what: str) -> UserError:
    return UserError(f"campaign '{campaign.path}': {key} {what}.")


class _naming:
    """Names the file and the key in a mistake that is found inside."""

    def __init__(self, campaign: Campaign, key: str) -> None:
        self._campaign, self._key = campaign, key

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, UserError):
            raise UserError(f"campaign '{self._campaign.path}': {self._key}: {error}") from None
