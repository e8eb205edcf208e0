"""Tables of a campaign: what it would cost, and how far it is."""

from __future__ import annotations

import time
from datetime import timedelta

from rich.box import SIMPLE_HEAD
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table

from humoslope.campaign.cost import Cost, Estimate
from humoslope.campaign.file import CALIBRATE, TRAIN
from humoslope.campaign.plan import Job, Plan
from humoslope.campaign.run import Run, State

REFRESH_S = 4.0
"""Time between two updates of the table on the screen, s."""


class Board:
    """Shows a campaign while it runs: on a terminal as a table that is kept up to date, else by a line for each job.

    Args:
        at_once: Most jobs that run at once.
        speed: Environment steps per second of a training that the time left is estimated with; 0 for the measured one.
    """

    def __init__(self, run: Run, console: Console, at_once: int, speed: float = 0.0) -> None:
        self._run, self._console, self._at_once, self._speed = run, console, at_once, speed
        self._live: Live | None = None
        self._shown = -REFRESH_S

    def __enter__(self) -> Board:
        if self._console.is_terminal:
            self._live = Live(console=self._console, auto_refresh=False, transient=True)
            self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._live is not None:
            self._live.stop()
        self._console.print(self.table())

    def show(self, event: str) -> None:
        """Says an event, if there is one, and updates the table."""
        if event:
            stamp = time.strftime("%H:%M:%S")
            self._console.print(f"{stamp}  {event}", soft_wrap=True, highlight=False, markup=False)
        now = time.monotonic()
        if self._live is not None and (event or now - self._shown >= REFRESH_S):
            self._shown = now
            self._live.update(self.table(), refresh=True)

    def table(self) -> Group:
        """The state of every training and evaluation, with what is left in all."""
        estimate = Estimate(self._run, self._speed)
        return Group(status(self._run, estimate), self._total(estimate))  # a caption would be as narrow as the table

    def _total(self, estimate: Estimate) -> str:
        run = self._run
        counts = [f"{run.count(state)} {said}" for state, said in SAID.items() if run.count(state) or state == "done"]
        left = estimate.left_s(self._at_once) if run.count("waiting") or run.count("running") else None
        return ", ".join(counts) + ("" if left is None else f"; about {in_words(left)} left")


SAID: dict[State, str] = {
    "done": "done",
    "running": "running",
    "waiting": "left",
    "failed": "failed",
    "barred": "barred by a failure",
}
"""States of jobs in words."""


def status(run: Run, estimate: Estimate) -> Table:
    """A row for each training: how far it is, how fast, and the states of what is made of its result."""
    columns = _columns(run.plan)
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("row", no_wrap=True)
    for title in ("seed", "iterations", "M steps", "steps/s"):
        table.add_column(title, justify="right", no_wrap=True)
    for title in (TRAIN, *columns):
        table.add_column(title, no_wrap=True)
    last = ""
    for job in _trainings(run.plan):
        progress = estimate.progress[job.name]
        others = [_of(run, job, column) for column in columns]
        table.add_row(
            job.row if job.row != last else "",
            str(job.seed),
            f"{progress.iterations}/{job.iterations}",
            f"{progress.iterations * job.scale.samples / 1e6:.2f}",
            f"{progress.speed:,.0f}" if progress.speed else "-",
            _state(run, job),
            *("-" if other is None else _state(run, other) for other in others),
        )
        last = job.row
    return table


def dry_run(run: Run, speed: float, at_once: int) -> Group:
    """What is left of a campaign: iterations, steps, hours and disk of every row, and of every evaluation."""
    estimate, plan = Estimate(run, speed), run.plan
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("what", no_wrap=True)
    for title in ("of", "done", "iterations", "M steps left", "hours left", "GB left"):
        table.add_column(title, justify="right", no_wrap=True)

    def line(name: str, jobs: list[Job], iterations: str) -> None:
        done = sum(run.states[job.name] == "done" for job in jobs)
        table.add_row(name, str(len(jobs)), str(done), iterations, *_costs(estimate.of(jobs)))

    for row in plan.campaign.trainings:
        jobs = [job for job in _trainings(plan) if job.row == row]
        line(row, jobs, str(jobs[0].iterations))
    for column in _columns(plan):
        line(column, [job for job in plan.jobs.values() if job.column == column], "")
    whole = estimate.of(plan.jobs.values())
    table.add_section()
    done = sum(state == "done" for state in run.states.values())
    table.add_row("all", str(len(plan.jobs)), str(done), "", *_costs(whole))
    notes = [f"Hours of one job after the other; {at_once} at once."]
    if estimate.speed is None:
        notes = ["No speed is known yet: name one with --speed, in environment steps per second of a training."]
    else:
        notes[0] = f"At {estimate.speed:,.0f} steps/s of a training. {notes[0]}"
    if any(column == CALIBRATE for column in _columns(plan)):
        notes.append("Calibrations are counted once one is done.")
    return Group(table, *notes)


def in_words(seconds: float) -> str:
    """A duration such as "1 day, 2:03" in hours and minutes."""
    return str(timedelta(minutes=round(seconds / 60.0))).removesuffix(":00") + " h"


def _costs(cost: Cost) -> tuple[str, str, str]:
    hours = "-" if cost.seconds is None else f"{cost.seconds / 3600.0:.2f}"
    return f"{cost.steps / 1e6:.2f}", hours, f"{cost.bytes / 1e9:.2f}"


def _trainings(plan: Plan) -> list[Job]:
    """Trainings in the order of the file."""
    jobs = [job for job in plan.jobs.values() if job.column == TRAIN]
    rows = {row: (i, training.seeds) for i, (row, training) in enumerate(plan.campaign.trainings.items())}
    return sorted(jobs, key=lambda job: (rows[job.row][0], rows[job.row][1].index(job.seed)))


def _columns(plan: Plan) -> list[str]:
    there = {job.column for job in plan.jobs.values()}
    return [column for column in (CALIBRATE, *plan.campaign.evaluations) if column in there]


def _of(run: Run, training: Job, column: str) -> Job | None:
    jobs = run.plan.jobs.values()
    return next((j for j in jobs if (j.row, j.seed, j.column) == (training.row, training.seed, column)), None)


def _state(run: Run, job: Job) -> str:
    state = run.states[job.name]
    if state == "running":
        return f"running {timedelta(seconds=int(time.monotonic() - run.started[job.name]))}"
    return {"waiting": "", "barred": "barred"}.get(state, state)
