"""`humoslope evaluate CHECKPOINT ...`: the held-out benchmark, and the slope-limit sweep."""

from __future__ import annotations

import dataclasses
import json
import shlex
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console
from rich.live import Live
from torch import Tensor

import humoslope
from humoslope.cli.measure import trained, warn
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.evaluation.report.paper import read_paper
from humoslope.evaluation.report.results import from_report, to_report
from humoslope.evaluation.report.tables import ablation_table, cells_table, diagnostics_table, main_table
from humoslope.evaluation.track import store
from humoslope.evaluation.track.arrays import map_arrays
from humoslope.evaluation.track.progress import Progress, cell_table, view
from humoslope.evaluation.track.protocol import HeldOutProtocol, sweep_protocol
from humoslope.evaluation.track.store import Walked
from humoslope.evaluation.track.summary import ENOUGH, SlopeLimit, slope_limit
from humoslope.evaluation.track.trials import HeldOutTrials, Relay, held_out_env_cfg, walk
from humoslope.files import check_place, write_text
from humoslope.learning.policy import Provenance, load_actor
from humoslope.provenance import git_state, plain
from humoslope.registry import TaskCfg

REFRESH_S = 2.0
"""Time between two looks at the table, s."""
SAVE_S = 60.0
"""Time between two writings of the finished trials, s."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Lets a trained policy walk the held-out track at every grade and friction, and writes the paper's figures of it.

    With several checkpoints of one method their trials are pooled. Finished trials are kept: an evaluation that was
    interrupted goes on when the same command is given again, and one with more --trials builds on one with fewer.

    Attributes:
        checkpoints: Checkpoints, or run folders for their newest ones.
        protocol: What is measured.
        sweep: Find the steepest grade that is mastered instead: every degree from 10 to 40 at the middle friction.
        out: Where the figures are written, without ending; by default beside the first checkpoint.
        lanes: Trials of a cell that are walked side by side.
        fresh: Walk all trials anew, whatever is saved.
    """

    checkpoints: tyro.conf.Positional[tuple[Path, ...]]
    protocol: Annotated[HeldOutProtocol, tyro.conf.arg(name="")]
    sweep: bool = False
    out: Path | None = None
    lanes: int = 32
    fresh: bool = False


def run(arguments: list[str]) -> None:
    """Evaluates the checkpoints named in `arguments`."""
    protocol = sweep_protocol() if "--sweep" in arguments else HeldOutProtocol()
    default = Options(checkpoints=tyro.MISSING, protocol=protocol)
    options = tyro.cli(Options, args=arguments, prog="humoslope evaluate", default=default)
    if not options.checkpoints:
        raise UserError("evaluate needs a checkpoint, such as logs/.../model_1000.pt.")
    if options.lanes < 1:
        raise UserError(f"evaluate: lanes is {options.lanes}; each cell needs at least 1.")
    found = [trained(path) for path in options.checkpoints]
    options.protocol.find_course()
    sources = [source for source, _ in found]
    for i, source in enumerate(sources):
        if source.sha256 in (other.sha256 for other in sources[:i]):
            raise UserError(f"evaluate: checkpoint '{source.path}' is given twice; its trials would count twice.")
    out = options.out or sources[0].path.with_suffix(".sweep" if options.sweep else ".heldout")
    check_place(_beside(out, ".json"))

    console = Console()
    evaluations: list[_Evaluation] = []
    interrupted = False
    with _interruptible() as stopped:
        for source, task in found:
            evaluation = _Evaluation(source, task, options, out, console)
            evaluations.append(evaluation)
            interrupted = not evaluation.walk(stopped)
            if interrupted:
                break
    _conclude(console, evaluations, options, out, arguments)
    if interrupted:
        raise KeyboardInterrupt


class _Evaluation:
    """One checkpoint's trials, from the saved ones to the last.

    Attributes:
        walked: What there is.
    """

    def __init__(self, source: Provenance, task: TaskCfg, options: Options, out: Path, console: Console) -> None:
        self.source, self.protocol, self._console = source, options.protocol, console
        course = options.protocol.find_course()
        relay = Relay(options.protocol, course, options.lanes)
        cfg = held_out_env_cfg(task.env, relay)
        self._mark = store.fingerprint(cfg, relay, source.sha256)
        self._path = _beside(out, f".{self._mark[:8]}.npz")
        found = None if options.fresh else store.load(self._path, self._mark, options.protocol)
        relay.earlier = found and found.trials
        self.env = ManagerBasedRlEnv(cfg)
        self._relay = relay
        self._actor = load_actor(source.path, self.env, source.task)
        self.walked = found or Walked(relay.trials(), 0.0, ())

    @property
    def finished(self) -> bool:
        """Whether no trial is left."""
        return bool(self.walked.trials.finished.all())

    def walk(self, stopped: list[bool]) -> bool:
        """Walks what is left; returns whether that was everything."""
        relay, protocol = self._relay, self.protocol
        self._introduce()
        shown = written = time.monotonic()
        started = shown - self.walked.wall_clock_s
        code = self.walked.code if self.finished else (*dict.fromkeys([*self.walked.code, _commit()]),)

        def keep() -> None:
            self.walked = Walked(relay.trials(), time.monotonic() - started, code)
            store.save(self._path, self.walked, self._mark, protocol)

        progress = Progress(relay.progress(), self.env.step_dt)
        title = f"{self.source.task}, iteration {self.source.iteration}"

        def picture() -> Any:
            return view(relay.trials(), protocol, title, progress.line(relay.progress()))

        def on_step(running: Tensor) -> None:
            nonlocal shown, written
            progress.step(int(running.sum()))
            if stopped:
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
                walk(self.env, self._actor, relay, on_step)
            except KeyboardInterrupt:
                pass
            finally:
                keep()
        return self.finished

    def _introduce(self) -> None:
        env, sim, protocol = self.env, self.env.cfg.sim, self.protocol
        done = int(self.walked.trials.finished.sum())
        lines = [
            f"[bold]{self.source.task}[/bold], iteration {self.source.iteration}, "
            f"{self.source.total_steps / 1e6:.2f} M steps; {self.source.path}",
            f"{protocol.trials} trials in each of {protocol.num_cells} cells, {env.num_envs} worlds; physics "
            f"'{env.sim.backend}' on {env.device}, {sim.timestep * 1e3:g} ms x {sim.decimation}, {sim.cone} cone",
        ]
        if departs := protocol.departures(HeldOutProtocol()):
            lines.append(f"[yellow]departs from the protocol: {departs}[/yellow]")
        if done:
            lines.append(f"goes on with {done} trials that were finished before")
        self._console.print("\n".join(lines), highlight=False, soft_wrap=True)


def _conclude(
    console: Console, evaluations: list[_Evaluation], options: Options, out: Path, arguments: list[str]
) -> None:
    protocol = options.protocol
    trials = map_arrays(lambda *parts: np.concatenate(parts), *(e.walked.trials for e in evaluations))
    walked, wanted = int(trials.finished.sum()), len(options.checkpoints) * protocol.num_trials
    pooled = dataclasses.replace(protocol, trials=protocol.trials * len(options.checkpoints))
    console.print(cell_table(trials, pooled, "Held-out track"))
    partial = walked < wanted
    if partial:
        console.print(
            f"[yellow]Partial: {walked} of {wanted} trials. Failures end sooner than successes, so the rates are too "
            "low; the same command goes on.[/yellow]",
            soft_wrap=True,
        )
    limit = None if partial or not options.sweep else _limit(trials, protocol)
    if limit is not None:
        console.print(_say(limit, protocol), soft_wrap=True)
    for evaluation in evaluations:
        console.print(evaluation.source.training, soft_wrap=True, highlight=False)
        warn(console, evaluation.env.sim.warnings())
    report = _report(evaluations, trials, options) | {
        "trials": wanted,
        "partial": partial,
        "slope_limit": None if limit is None else plain(limit),
        "command_line": shlex.join(["humoslope", "evaluate", *arguments]),
    }
    results = [from_report(report)]
    sheets = [cells_table(results)]
    if not options.sweep:
        paper = read_paper()
        sheets = [main_table(results, paper), ablation_table(results, paper), diagnostics_table(results), *sheets]
        sheets[0].show()
    texts = {
        ".json": json.dumps(report, indent=2, allow_nan=False) + "\n",
        ".csv": sheets[-1].to_csv(),
        ".md": "\n".join(sheet.to_markdown() for sheet in sheets),
    }
    for end, text in texts.items():
        path = _beside(out, end)
        write_text(path, text)
        console.print(f"wrote {path}", soft_wrap=True)


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


def _report(evaluations: list[_Evaluation], trials: HeldOutTrials, options: Options) -> dict[str, Any]:
    env = evaluations[0].env
    return {
        "what": "sweep" if options.sweep else "held-out",
        "version": humoslope.__version__,
        "code": ", ".join(dict.fromkeys(commit for e in evaluations for commit in e.walked.code)),
        "checkpoints": [plain(e.source) for e in evaluations],
        "protocol": plain(options.protocol),
        "lanes": options.lanes,
        "physics": plain(env.cfg.sim) | {"backend": env.sim.backend, "device": str(env.device)},
        "wall_clock_s": round(sum(e.walked.wall_clock_s for e in evaluations), 1),
        "finished": int(trials.finished.sum()),
        "successes": int(trials.success.sum()),
        **to_report(
            trials[trials.finished],
            grades=options.protocol.grades,
            tiers=options.protocol.tiers,
            segments=options.protocol.find_course().segments,
            speed=options.protocol.speed,
            mass=env.robot.total_mass,
        ),
    }


def _commit() -> str:
    return git_state().splitlines()[0]


def _beside(out: Path, ending: str) -> Path:
    """`out` with an ending added; a name like model_1000.heldout keeps its dot."""
    return out.with_name(out.name + ending)


@contextmanager
def _interruptible() -> Iterator[list[bool]]:
    """While inside, SIGINT and SIGTERM only put a sign into the list, so that no trial is left half written."""
    stopped: list[bool] = []
    handlers = {n: signal.signal(n, lambda *_: stopped.append(True)) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stopped
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
