"""Runs the jobs of a campaign that are left, some at once, each in a process of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Literal, Protocol

from humoslope.campaign import disk
from humoslope.campaign.file import TRAIN
from humoslope.campaign.plan import Job, Plan
from humoslope.cpu import SHARE
from humoslope.errors import UserError
from humoslope.interrupts import deferred_interrupts

State = Literal["waiting", "running", "done", "failed", "barred"]
"""A job is barred when one that it needs has failed."""
POLL_S = 0.2
"""Time between two looks at the processes, s."""
PATIENCE_S = 120.0
"""Longest time that a run folder may still be held by a training of a campaign that was killed, s."""
CHILD = "humoslope.campaign.child"


class Process(Protocol):
    """A process that was started, as `subprocess.Popen` has it."""

    def poll(self) -> int | None:
        """The exit code; None while it runs."""
        ...

    def send_signal(self, sig: int) -> None:
        """Sends a signal."""
        ...

    def kill(self) -> None:
        """Ends it at once."""
        ...

    def wait(self) -> int:
        """Waits for its end."""
        ...


Launch = Callable[[list[str], Mapping[str, str], IO[bytes]], Process]
"""Starts `humoslope` with words, environment variables beside the present ones, and a file for all it prints."""


def launch(words: list[str], env: Mapping[str, str], log: IO[bytes]) -> Process:
    """Starts `humoslope` in a session of its own, so that Ctrl-C reaches this process alone, which passes it on."""
    command = [sys.executable, "-m", CHILD, str(os.getpid()), *words]
    return subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=subprocess.STDOUT,
        env={**os.environ, **env},
        start_new_session=True,
    )


@dataclass
class Run:
    """A campaign that is being run.

    Attributes:
        plan: Its jobs.
        states: State of each job.
        reasons: What is known of jobs that failed, or are barred.
        started: When those that are running began, by the monotonic clock, s.
    """

    plan: Plan
    states: dict[str, State] = field(init=False)
    reasons: dict[str, str] = field(default_factory=dict)
    started: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.states = {name: "done" if disk.is_done(job) else "waiting" for name, job in self.plan.jobs.items()}

    def count(self, state: State) -> int:
        """Number of jobs in a state."""
        return list(self.states.values()).count(state)

    def ready(self) -> list[Job]:
        """Jobs that can begin, in the plan's order."""
        return [
            job
            for name, job in self.plan.jobs.items()
            if self.states[name] == "waiting" and all(self.states[need] == "done" for need in job.needs)
        ]

    def fail(self, job: Job, reason: str) -> None:
        """Marks a job as failed, and all that need it as barred."""
        self.states[job.name], self.reasons[job.name] = "failed", reason
        for name, other in self.plan.jobs.items():  # each comes after those it needs
            if self.states[name] == "waiting" and any(
                self.states[need] in ("failed", "barred") for need in other.needs
            ):
                self.states[name], self.reasons[name] = "barred", f"{job.name} failed"


def run(
    run: Run,
    jobs: int,
    threads: int,
    show: Callable[[str], None] = lambda event: None,
    start: Launch = launch,
    clock: Callable[[], float] = time.monotonic,
) -> int:
    """Runs what is left of a campaign.

    Args:
        jobs: Most jobs that run at once.
        threads: Threads of each.
        show: Called with a sentence whenever a job begins or ends, and with "" in between.
        start: Starts a process.

    Returns:
        0 if every job is done or has failed, else the signal that ended it early. The first signal is passed on to the
        jobs, which save; a second one that is Ctrl-C ends them at once.
    """
    running: dict[str, _Running] = {}
    held_since: dict[str, float] = {}  # trainings whose folder another one has
    forwarded = False
    try:
        with deferred_interrupts(second_raises=True) as interrupt:
            while True:
                for name in [name for name, child in running.items() if child.process.poll() is not None]:
                    child = running.pop(name)
                    child.log.close()
                    show(_ended(run, child, interrupt.requested))
                if interrupt.requested and not forwarded:
                    forwarded = True
                    for child in running.values():
                        with suppress(ProcessLookupError):
                            child.process.send_signal(interrupt.number)
                    show("Stopping; running jobs save their state. Ctrl-C once more stops at once, without saving.")
                if not interrupt.requested:
                    for job in run.ready():
                        if len(running) == jobs:
                            break
                        if _is_held(job) and clock() - held_since.setdefault(job.name, clock()) < PATIENCE_S:
                            continue
                        try:
                            running[job.name] = _begun(run, job, threads, start, clock)
                            show(f"begins: {job.name}")
                        except UserError as error:  # other jobs go on
                            run.fail(job, str(error))
                            show(f"failed: {job.name}: {error}")
                if not running and (interrupt.requested or not run.ready()):
                    return interrupt.number if interrupt.requested else 0
                show("")
                time.sleep(POLL_S)
    finally:
        for child in running.values():
            child.process.kill()
            child.process.wait()
            child.log.close()


@dataclass
class _Running:
    job: Job
    process: Process
    log: IO[bytes]
    log_path: Path


def _is_held(job: Job) -> bool:
    """True if a training has the folder that this one is to have: one of a campaign that was killed may still save."""
    return job.column == TRAIN and disk.in_use(job.folder)


def _begun(run: Run, job: Job, threads: int, start: Launch, clock: Callable[[], float]) -> _Running:
    if job.column == TRAIN:
        disk.clear_abandoned(job.folder)
    path = log_path(run.plan, job)
    path.parent.mkdir(parents=True, exist_ok=True)
    log = path.open("wb")
    # A child's own text must not be wrapped at the width of this terminal.
    env = {"OMP_NUM_THREADS": str(threads), SHARE: str(threads), "COLUMNS": "140"}
    try:
        process = start(disk.command(job), env, log)
    except BaseException:
        log.close()
        raise
    run.states[job.name], run.started[job.name] = "running", clock()
    return _Running(job, process, log, path)


def _ended(run: Run, child: _Running, stopping: bool) -> str:
    """Notes the end of a job, and says it in a sentence."""
    job, code = child.job, child.process.wait()
    run.started.pop(job.name, None)
    if code == 0 and disk.is_done(job):
        run.states[job.name] = "done"
        return f"done: {job.name}"
    if stopping and code != 2:
        run.states[job.name] = "waiting"
        return f"stopped: {job.name}"
    reason = _said(child.log_path) or f"see {child.log_path}"
    if code == 0:
        reason = f"it ended without an error but left no '{job.result}'"
    elif code < 0:
        reason = f"killed by {signal.Signals(-code).name}"
    run.fail(job, f"exit code {code}: {reason}")
    return f"failed: {job.name}: {run.reasons[job.name]}"


def log_path(plan: Plan, job: Job) -> Path:
    """File with what a job's last process printed."""
    return plan.folder / "log" / f"{job.row}-seed{job.seed}-{job.column}.txt"


def _said(path: Path) -> str:
    """The last sentence that `humoslope` said of its failure."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return ""
    said = [line for line in lines if line.startswith("humoslope: ")]
    return said[-1].removeprefix("humoslope: ") if said else ""
