"""What is left of a campaign, in steps, time and disk."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from statistics import fmean

from humoslope.campaign import disk
from humoslope.campaign.file import CALIBRATE, TRAIN
from humoslope.campaign.plan import Job
from humoslope.campaign.run import Run

EVALUATION_SPEED = 0.37
"""Environment steps per second of an evaluation, as a share of a training's on the same CPU: its physics steps are
finer, and its cone is elliptic. On two cores 3,160 on the held-out track (results/heldout/stage2.json) to 8,470 of PPO
with 512 worlds (results/bench.json)."""
CHECKPOINT = {"cpu": 3.3e6, "gpu": 7.6e6}
"""Size of a checkpoint of the two stages where there is none to look at, bytes: that of the shipped ones, and the same
with the wider networks of the other preset."""
EPISODES = 24e3
"""Size of the state of an env's episode, of which a run keeps the newest, bytes."""


@dataclass(frozen=True)
class Cost:
    """What some jobs still cost.

    Attributes:
        steps: Environment steps of training.
        seconds: Time of one job after the other; None if no speed is known.
        bytes: Space that the trainings will take.
    """

    steps: int
    seconds: float | None
    bytes: float

    def __add__(self, other: Cost) -> Cost:
        unknown = self.seconds is None or other.seconds is None
        seconds = None if unknown else self.seconds + other.seconds  # type: ignore[operator]
        return Cost(self.steps + other.steps, seconds, self.bytes + other.bytes)


NOTHING = Cost(0, 0.0, 0.0)


class Estimate:
    """Estimates what jobs cost from what has been measured in the campaign's folder.

    Args:
        speed: Environment steps per second of a training; 0 for what those in the folder made.

    Attributes:
        speed: That speed; None if none is known.
    """

    def __init__(self, run: Run, speed: float = 0.0) -> None:
        self._run = run
        trainings = [job for job in run.plan.jobs.values() if job.column == TRAIN]
        self.progress = {job.name: disk.progress(job, run.states[job.name] == "running") for job in trainings}
        running = [p.speed for name, p in self.progress.items() if p.speed and run.states[name] == "running"]
        measured = running or [p.speed for p in self.progress.values() if p.speed]
        self.speed: float | None = speed or (fmean(measured) if measured else None)
        self._took: dict[str, float | None] = {}

    def of(self, jobs: Iterable[Job]) -> Cost:
        """What these jobs still cost. Those that have failed, or are barred, count too: they will be run again."""
        return sum((self._one(job) for job in jobs), NOTHING)

    def left_s(self, at_once: int) -> float | None:
        """Time left of a campaign that runs; None if it is not known."""
        left = [job for name, job in self._run.plan.jobs.items() if self._run.states[name] in ("waiting", "running")]
        seconds = self.of(left).seconds
        return None if seconds is None else seconds / max(1, min(at_once, len(left)))

    def _one(self, job: Job) -> Cost:
        if self._run.states[job.name] == "done":
            return NOTHING
        if job.column == TRAIN:
            left = job.iterations - self.progress[job.name].iterations
            steps = left * job.scale.samples
            files = -(-left // job.scale.save_interval) + (left == job.iterations)
            size = files * self._checkpoint_size(job) + (EPISODES * job.scale.num_envs if left == job.iterations else 0)
            return Cost(steps, steps / self.speed if self.speed else None, size)
        return Cost(0, self._walk_s(job), 0.0)

    def _walk_s(self, job: Job) -> float | None:
        """Time of a calibration or an evaluation, as those took that are done; else by its steps."""
        if job.column not in self._took:
            alike = [other for other in self._run.plan.jobs.values() if other.column == job.column]
            done = [disk.wall_clock_s(other) for other in alike if self._run.states[other.name] == "done"]
            known = [took for took in done if took is not None]
            steps = self._run.plan.walks.get(job.column, 0)
            by_steps = steps / (EVALUATION_SPEED * self.speed) if self.speed else None
            self._took[job.column] = fmean(known) if known else 0.0 if job.column == CALIBRATE else by_steps
        return self._took[job.column]

    def _checkpoint_size(self, job: Job) -> float:
        for name, other in self._run.plan.jobs.items():
            if other.column == TRAIN and self._run.states[name] == "done":
                return float(other.result.stat().st_size)
        return CHECKPOINT.get(job.scale.preset, CHECKPOINT["cpu"])
