"""What lies on disk of a campaign: all that is known of how far its jobs are.

A training is done when its last checkpoint is there, and goes on from its newest one. An evaluation is done when its
result is there, whole, of that checkpoint and by these options.
"""

from __future__ import annotations

import fcntl
import os
import re
import shlex
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from statistics import fmean
from typing import Any

from humoslope.campaign.file import CALIBRATE, OWN_OF_TRAINING, TRAIN, Campaign
from humoslope.campaign.plan import Job, Plan
from humoslope.errors import UserError
from humoslope.evaluation.report.results import CAMPAIGN
from humoslope.files import is_locked, write_bytes
from humoslope.learning.logger import read_line
from humoslope.learning.run_folder import LOOKING, saved_options, start_of
from humoslope.seal import read_json
from humoslope.words import option_groups

LEFT_BY_A_START = ("starts", "console.log", "events.out.*", "videos", "diverged", "episodes_*.pt")
"""What a training leaves in its folder before its first checkpoint."""
MODEL = re.compile(r"model_(\d+)\.pt")
RECENT = 20
"""Iterations over which the speed of a training is averaged."""


@dataclass(frozen=True)
class Progress:
    """How far a training is.

    Attributes:
        iterations: Iterations that are done; of a running one as it printed them, else those of its newest checkpoint.
        speed: Environment steps per second over the last iterations; None if it printed none.
    """

    iterations: int
    speed: float | None


def is_done(job: Job) -> bool:
    """True if the result of a job is there."""
    if not job.result.is_file():
        return False
    if job.column == TRAIN:
        return True
    try:
        report = read_json(job.result)
        if job.column == CALIBRATE:
            return isinstance(report, dict)
        source = report["checkpoint"] if job.verb == "ramps" else report["checkpoints"][0]
        same = _without_paths(report["command_line"]) == _without_paths(shlex.join(["humoslope", job.verb, *job.words]))
        return same and not report.get("partial", False) and source["iteration"] == job.iterations - 1
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError):
        return False  # damaged, or of something else: it is made anew


def newest(folder: Path) -> int:
    """Iterations in the newest checkpoint of a run folder; 0 if it holds none."""
    found = [int(match[1]) + 1 for path in folder.glob("model_*.pt") if (match := MODEL.fullmatch(path.name))]
    return max(found, default=0)


def progress(job: Job, running: bool) -> Progress:
    """How far the training in a job's folder is."""
    saved = newest(job.folder)
    lines = [line for text in _tail(job.folder / "console.log") if (line := read_line(text)) is not None]
    speed = fmean(line.speed for line in lines[-RECENT:]) if lines else None
    # What was printed after the newest checkpoint is lost once it is stopped.
    done = max(saved, lines[-1].iteration) if running and lines else saved
    return Progress(min(done, job.iterations), speed)


def wall_clock_s(job: Job) -> float | None:
    """Time that an evaluation or a calibration took, s; None if it is not known."""
    try:
        return _wall_clock_s(job.result, job.result.stat().st_mtime_ns)
    except OSError:
        return None


@lru_cache(maxsize=4096)
def _wall_clock_s(path: Path, changed: int) -> float | None:
    """As it says in a file; that is read once unless it was changed."""
    try:
        return float(read_json(path)["wall_clock_s"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def command(job: Job) -> list[str]:
    """Words after `humoslope` that do what is left of a job."""
    if job.column == TRAIN and newest(job.folder):
        task, most = job.words[0], str(job.iterations)
        return ["train", task, "--resume", str(job.folder), "--agent.max-iterations", most]
    return [job.verb, *job.words]


def settled(campaign: Campaign, folder: Path) -> Campaign:
    """The campaign with the scale of what has begun in its folder, if its file leaves that to the machine."""
    for run_dir in sorted(folder.glob("*/seed*")) if campaign.preset == "auto" else ():
        preset = option_groups(saved_options(run_dir)).get("--preset", [])[-1:]
        if newest(run_dir) and preset in (["cpu"], ["gpu"]):
            return replace(campaign, preset="cpu" if preset == ["cpu"] else "gpu")
    return campaign


def check_begun(plan: Plan) -> None:
    """Compares the trainings that have begun with the file.

    Raises:
        UserError: If one was begun with another task, parent or options: a table must not mix them.
    """
    for job in plan.jobs.values():
        done = newest(job.folder) if job.column == TRAIN else 0
        if not done:
            continue
        longer = f"has {done} iterations, more than {job.iterations}" if done > job.iterations else ""
        if said := longer or _change(job):
            raise UserError(
                f"campaign '{plan.campaign.path}': train.{job.row}: the run in '{job.folder}' {said}; "
                "undo the change, name the row anew, or choose another folder with --out."
            )


def _change(job: Job) -> str:
    """Where the file says something else now than a run was begun with, such as "was begun with ..."; or ""."""
    about = start_of(job.folder)
    if about is None:
        return ""
    task, *options = job.words
    if about.get("task") != task:
        return f"was begun with task {about.get('task')}"
    origin = about.get("from")
    if not _is_same(origin, job.parent):
        return f"was begun with parent {origin or 'none'}"
    then, now = option_groups(saved_options(job.folder)), option_groups(options)
    if then.get("--preset", ["--preset", job.scale.preset])[1] != job.scale.preset:
        return f"was begun with {' '.join(then['--preset'])}"
    theirs = f"--env.rewards.{job.scale.calibrated.replace('_', '-')}.params."
    for name in {**then, **now}:
        if name in LOOKING or (name in OWN_OF_TRAINING and name != "--env.seed"):
            continue
        if name not in now and job.scale.calibrated and name.startswith(theirs):
            continue  # set by the calibration
        if then.get(name) != now.get(name):
            return f"was begun with {' '.join(then[name]) if name in then else f'the default of {name}'}"
    return ""


def _is_same(origin: Any, parent: Path | None) -> bool:
    """True if a recorded parent is this one, wherever the campaign's folder lay then."""
    if origin is None or parent is None:
        return origin is None and parent is None
    count = 3 if re.fullmatch(r"seed\d+", parent.parent.name) else 1  # ROW/seedN/model_M.pt
    return Path(origin).parts[-count:] == parent.parts[-count:]


def clear_abandoned(folder: Path) -> None:
    """Removes a run folder in which a training was stopped before its first checkpoint: nothing goes on from it.

    Raises:
        UserError: If something else lies there, such as results of a training whose checkpoints were removed.
    """
    if not folder.is_dir() or newest(folder) or in_use(folder):
        return
    if not all(any(path.match(pattern) for pattern in LEFT_BY_A_START) for path in folder.iterdir()):
        raise UserError(f"'{folder}' holds no checkpoint, but other files; move them, or choose another --out.")
    shutil.rmtree(folder)


def in_use(folder: Path) -> bool:
    """True if a training, or another campaign, holds a folder."""
    try:
        return is_locked(folder)
    except OSError:
        return False


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Keeps the folder of a campaign for this process while inside; the system lets go of it however that ends.

    Raises:
        UserError: If another campaign has it, or it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise UserError(f"campaign folder '{folder}' cannot be made: {error.strerror}.") from None
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise UserError(f"campaign folder '{folder}' is in use by another campaign.") from None
        yield
    finally:
        os.close(handle)
        with suppress(OSError):
            folder.rmdir()  # if nothing came of it


def leave_file(plan: Plan, folder: Path) -> None:
    """Leaves a copy of the campaign's file in a folder: a record, and the order of its rows for tables."""
    content = plan.campaign.path.read_bytes()
    copy = folder / CAMPAIGN
    if not copy.is_file() or copy.read_bytes() != content:
        write_bytes(copy, content)


def _without_paths(command_line: str) -> dict[str, list[str]]:
    """Options by name of a command of `evaluate` or `ramps`, without its checkpoint and its destination."""
    _, verb, _, *options = shlex.split(command_line)
    return option_groups([*options, f"--verb={verb}"]) | {"--out": []}


def _tail(path: Path, size: int = 20_000) -> Sequence[str]:
    """The last lines of a file; none if it cannot be read."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - size))
            return file.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return []
