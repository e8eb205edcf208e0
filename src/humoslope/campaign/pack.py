"""The results of a campaign, small enough to be committed: actors, calibrations, curves, results.

What is packed lies as in the campaign's folder, and is one: a campaign goes on from there, but for trainings that are
not done.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import torch

from humoslope.campaign import disk
from humoslope.campaign.file import TRAIN
from humoslope.campaign.plan import Job, Plan
from humoslope.errors import UserError
from humoslope.evaluation.report.curve import CURVE, read_curves, write_table
from humoslope.evaluation.report.results import CAMPAIGN
from humoslope.files import check_place, write_bytes, write_text
from humoslope.learning import checkpoint

RECORDS = ("options.txt", "start.json")
"""Files of each start of a run that are kept."""


def pack(plan: Plan, out: Path) -> list[str]:
    """Packs every finished training with what was made of it; what is packed already is left as it is.

    Returns:
        The files that were written, relative to `out`.

    Raises:
        UserError: If something cannot be read or written.
    """
    if out.resolve() == plan.folder.resolve():
        raise UserError(f"--pack '{out}' is the folder of the campaign itself; name another one.")
    check_place(out / CAMPAIGN)
    written: list[str] = []
    for job in plan.jobs.values():
        if not disk.is_done(job):
            continue
        there = out / job.folder.relative_to(plan.folder)
        made = _training(job, there) if job.column == TRAIN else _result(job, there)
        written += [str(path.relative_to(out)) for path in made]
    if written:
        disk.leave_file(plan, out)
    return written


def _training(job: Job, there: Path) -> list[Path]:
    actor = there / job.result.name
    if actor.is_file():
        return []
    made = [actor]
    for start in sorted((job.folder / "starts").glob("*")):
        for name in RECORDS:
            if (start / name).is_file():
                made.append(there / "starts" / start.name / name)
                write_text(made[-1], (start / name).read_text(encoding="utf-8"))
    made.append(there / CURVE)
    write_table(read_curves(job.folder), made[-1])
    write_bytes(actor, actor_alone(job.result))  # last: with it, the training counts as done
    return made


def _result(job: Job, there: Path) -> list[Path]:
    """A JSON file, with the tables of the same name. It goes last, since with it the job counts as done."""
    made = []
    for source in (*(job.result.with_suffix(end) for end in (".md", ".csv")), job.result):
        target = there / source.name
        if source.is_file() and not (target.is_file() and target.read_bytes() == source.read_bytes()):
            there.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)
            made.append(target)
    return made


def actor_alone(path: Path) -> memoryview:
    """A checkpoint without what only a resumed training needs. Results and calibrations know it as the whole one."""
    state = checkpoint.load(path)
    state["formerly"] = (*state["formerly"], checkpoint.digest(path))
    state["learner"], state["rng"] = {}, {}
    state["env"] = {"curriculum": state["env"]["curriculum"], "level": torch.zeros(1, dtype=torch.int64)}
    del state["format"]
    return checkpoint.encoded(path, state)
