"""An evaluation on the track from its checkpoints to the written results; it can be interrupted and continued."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.live import Live
from torch import Tensor

import humoslope
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.evaluation.report.paper import read_paper
from humoslope.evaluation.report.results import from_report, to_report
from humoslope.evaluation.report.tables import ablation_table, causes_table, cells_table, diagnostics_table, main_table
from humoslope.evaluation.subject import Subject
from humoslope.evaluation.track import store
from humoslope.evaluation.track.arrays import map_arrays
from humoslope.evaluation.track.progress import Progress, cell_table, view
from humoslope.evaluation.track.protocol import HeldOutProtocol
from humoslope.evaluation.track.store import SavedTrials
from humoslope.evaluation.track.summary import ENOUGH, SlopeLimit, slope_limit
from humoslope.evaluation.track.trials import HeldOutTrials, TrialScheduler, held_out_env_cfg, run_trials
from humoslope.files import check_place, write_text
from humoslope.interrupts import Interrupt, deferred_interrupts
from humoslope.provenance import git_state, plain
from humoslope.seal import write_json

REFRESH_S = 2.0
"""Time between two updates of the table on the screen, s."""
SAVE_S = 60.0
"""Time between two writes of the finished trials, s."""


@dataclass(frozen=True)
class Plan:
    """Settings of an evaluation beyond its protocol.

    Attributes:
        protocol: Track, grades, friction and rules of a trial.
        sweep: Report the slope limit of a sweep instead of the paper's tables.
        parallel_trials: Trials of a cell that run side by side.
        fresh: Ignore trials that were saved before.
        out: Path of the results without ending; None for a file beside the first checkpoint.
        command_line: Command that the results are said to come from.
    """

    protocol: HeldOutProtocol
    sweep: bool
    parallel_trials: int
    fresh: bool
    out: Path | None
    command_line: str


def evaluate(subjects: list[Subject], plan: Plan, console: Console) -> int:
    """Runs the missing trials of all policies and writes the results, also after an interruption.

    Args:
        subjects: Policies of one method; their trials are pooled.

    Returns:
        0 if all trials are finished, else the signal that ended the evaluation early.

    Raises:
        UserError: If the plan is impossible, a policy is given twice, or two are of different tasks.
    """
    plan.protocol.find_course()
    sources = [subject.provenance for subject in subjects]
    for i, source in enumerate(sources):
        if source.sha256 in (other.sha256 for other in sources[:i]):
            raise UserError(f"evaluate: checkpoint '{source.path}' is given twice; its trials would count twice.")
        if source.task != sources[0].task:
            raise UserError(
                f"evaluate: '{sources[0].path}' is of {sources[0].task} and '{source.path}' of {source.task}; only "
                "trials of one method are pooled, so evaluate each of them by itself."
            )
    out = plan.out or subjects[0].beside("sweep" if plan.sweep else "heldout")
    check_place(_beside(out, ".json"))

    evaluations: list[_Evaluation] = []
    complete = True
    with deferred_interrupts() as interrupt:
        for subject in subjects:
            evaluation = _Evaluation(subject, plan, out, console)
            evaluations.append(evaluation)
            complete = evaluation.run(interrupt)
            if not complete:
                break
    _conclude(console, evaluations, plan, len(subjects), out)
    return interrupt.number if not complete else 0


class _Evaluation:
    """Trials of one policy, those saved before and those still to run.

    Attributes:
        saved: Trials, time and code so far.
    """

    def __init__(self, subject: Subject, plan: Plan, out: Path, console: Console) -> None:
        self.source, self.protocol, self._console = subject.provenance, plan.protocol, console
        course = plan.protocol.find_course()
        scheduler = TrialScheduler(plan.protocol, course, plan.parallel_trials)
        cfg = held_out_env_cfg(subject.env, scheduler, subject.groups)
        self._fingerprint = store.trial_fingerprint(cfg, scheduler, subject.provenance.sha256)
        self._path = _beside(out, f".{self._fingerprint[:8]}.npz")
        found = None if plan.fresh else store.load(self._path, self._fingerprint, plan.protocol)
        scheduler.earlier = found and found.trials
        self.env = ManagerBasedRlEnv(cfg)
        self._scheduler = scheduler
        self._actor = subject.load(self.env)
        self.saved = found or SavedTrials(scheduler.trials(), 0.0, ())

    @property
    def finished(self) -> bool:
        """True if no trial is left."""
        return bool(self.saved.trials.finished.all())

    def run(self, interrupt: Interrupt) -> bool:
        """Runs the trials that are left; returns True if all are finished."""
        scheduler, protocol = self._scheduler, self.protocol
        self._introduce()
        shown = written = time.monotonic()
        started = shown - self.saved.wall_clock_s
        code = self.saved.code if self.finished else (*dict.fromkeys([*self.saved.code, _commit()]),)

        def keep() -> None:
            self.saved = SavedTrials(scheduler.trials(), time.monotonic() - started, code)
            store.save(self._path, self.saved, self._fingerprint, protocol)

        progress = Progress(scheduler.progress(), self.env.step_dt)
        title = self.source.title

        def picture() -> Any:
            return view(scheduler.trials(), protocol, title, progress.line(scheduler.progress()))

        def on_step(running: Tensor) -> None:
            nonlocal shown, written
            progress.step(int(running.sum()))
            if interrupt.requested:
                raise KeyboardInterrupt
            now = time.monotonic()
            if now - shown > REFRESH_S:
                shown = now
                live.update(picture())
            if now - written > SAVE_S:
                written = now
                keep()

        with Live(picture(), console=self._console, auto_refresh=False, transient=True) as live:
            try:
                run_trials(self.env, self._actor, scheduler, on_step)
            except KeyboardInterrupt:
                pass
            finally:
                keep()
        return self.finished

    def _introduce(self) -> None:
        env, sim, protocol = self.env, self.env.cfg.sim, self.protocol
        done = int(self.saved.trials.finished.sum())
        lines = [
            f"[bold]{self.source.title}[/bold], {self.source.seen}; {self.source.path}",
            f"{protocol.trials} trials in each of {protocol.num_cells} cells, {env.num_envs} envs; physics "
            f"'{env.sim.backend}' on {env.device}, {sim.timestep * 1e3:g} ms x {sim.decimation}, {sim.cone} cone",
        ]
        if departs := protocol.departures(HeldOutProtocol()):
            lines.append(f"[yellow]departs from the protocol: {departs}[/yellow]")
        if done:
            lines.append(f"continues with {done} trials that were finished before")
        self._console.print("\n".join(lines), highlight=False, soft_wrap=True)


def _conclude(console: Console, evaluations: list[_Evaluation], plan: Plan, checkpoints: int, out: Path) -> None:
    protocol = plan.protocol
    trials = map_arrays(lambda *parts: np.concatenate(parts), *(e.saved.trials for e in evaluations))
    finished, wanted = int(trials.finished.sum()), checkpoints * protocol.num_trials
    pooled = dataclasses.replace(protocol, trials=protocol.trials * checkpoints)
    partial = finished < wanted
    limit = None if partial or not plan.sweep else _limit(trials, protocol)
    report = _report(evaluations, trials, plan) | {
        "trials": wanted,
        "partial": partial,
        "slope_limit": None if limit is None else plain(limit),
        "command_line": plan.command_line,
    }
    results = [from_report(report)]
    sheets = [cells_table(results)]
    if not plan.sweep:
        paper = read_paper()
        tables = (main_table(results, paper), ablation_table(results, paper), diagnostics_table(results))
        sheets = [*tables, causes_table(results), *sheets]
    texts = {
        ".csv": sheets[-1].to_csv(),
        ".md": "\n".join(sheet.to_markdown() for sheet in sheets),
    }
    write_json(_beside(out, ".json"), report)
    for end, text in texts.items():
        write_text(_beside(out, end), text)

    console.print(cell_table(trials, pooled, "Held-out track"))
    if partial:
        console.print(
            f"[yellow]Partial: {finished} of {wanted} trials. Failures end sooner than successes, so the rates are too "
            "low; the same command continues.[/yellow]",
            soft_wrap=True,
        )
    if limit is not None:
        console.print(_say(limit, protocol), soft_wrap=True)
    for evaluation in evaluations:
        console.print(evaluation.source.training, soft_wrap=True, highlight=False)
        for warning in evaluation.env.sim.warnings():
            console.print(f"[yellow]physics: {warning}[/yellow]")
    if not plan.sweep:
        sheets[0].show()
        if finished > int(trials.success.sum()):
            causes_table(results).show()
    for end in (".json", *texts):
        console.print(f"wrote {_beside(out, end)}", soft_wrap=True)


def _limit(trials: HeldOutTrials, protocol: HeldOutProtocol) -> SlopeLimit:
    at = [trials.grade_index == g for g in range(len(protocol.grades))]
    return slope_limit(protocol.grades, [int(trials.success[i].sum()) for i in at], [int(i.sum()) for i in at])


def _say(limit: SlopeLimit, protocol: HeldOutProtocol) -> str:
    if limit.grade is None:
        steepest = f"below {min(protocol.grades):g}°"
    else:
        steepest = f"{limit.grade:g}°" + (" or more" if limit.beyond else "")
    some = "none" if limit.any_success is None else f"{limit.any_success:g}°"
    return f"Max grade, SR of {100 * ENOUGH:g} % and more up to there: {steepest}; steepest with any success: {some}"


def _report(evaluations: list[_Evaluation], trials: HeldOutTrials, plan: Plan) -> dict[str, Any]:
    env = evaluations[0].env
    finished = trials[trials.finished]
    return {
        "what": "sweep" if plan.sweep else "held-out",
        "version": humoslope.__version__,
        "code": ", ".join(dict.fromkeys(commit for e in evaluations for commit in e.saved.code)),
        "checkpoints": [plain(e.source) for e in evaluations],
        "protocol": plain(plan.protocol),
        "parallel_trials": plan.parallel_trials,
        "physics": plain(env.cfg.sim) | {"backend": env.sim.backend, "device": str(env.device)},
        "wall_clock_s": round(sum(e.saved.wall_clock_s for e in evaluations), 1),
        "finished": int(trials.finished.sum()),
        "successes": int(trials.success.sum()),
        **to_report(
            finished,
            grades=plan.protocol.grades,
            tiers=plan.protocol.tiers,
            segments=plan.protocol.find_course().segments,
            speed=plan.protocol.speed,
            mass=env.robot.total_mass,
            causes=finished.causes(env.step_dt),
        ),
    }


def _commit() -> str:
    return git_state().splitlines()[0]


def _beside(out: Path, ending: str) -> Path:
    """`out` with an ending added; a name like model_1000.heldout keeps its dot."""
    return out.with_name(out.name + ending)
