"""What a live view costs a training: iterations with and without it in turn, in wall-clock and in processor time."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from humoslope.env import ManagerBasedRlEnv
from humoslope.learning.rng import seed_everything
from humoslope.learning.trainer import Trainer
from humoslope.registry import TaskCfg
from humoslope.replay.rerun.live import LiveView, live_view
from humoslope.screen import HOST

ALONE, UNSEEN, SEEN = "without", "nobody looks", "somebody looks"
WORLDS = 4


@dataclass(frozen=True)
class Cost:
    """Seconds of training iterations.

    Attributes:
        num_envs: Number of envs.
        wall_s, cpu_s: By `ALONE`, `UNSEEN` and `SEEN`, a value for each round: wall-clock time, and processor time of
            training with all its threads. The viewer's server is a process of its own, and not in it.
        own_s: By the same names, the part of `cpu_s` that the view itself takes: its calls and the threads that rerun
            started. Unlike the difference of two iterations it hardly varies with what else the machine does. Linux
            alone tells the time of threads; elsewhere only the calls are in it.
        pictures: Pictures that were sent per iteration while somebody looked.
    """

    num_envs: int
    wall_s: dict[str, list[float]]
    cpu_s: dict[str, list[float]]
    own_s: dict[str, list[float]]
    pictures: float

    def overhead(self, which: str, measured: dict[str, list[float]]) -> float:
        """Median over rounds of the additional share of time that a view takes."""
        return median(a / b - 1.0 for a, b in zip(measured[which], measured[ALONE], strict=True))

    def own_share(self, which: str) -> float:
        """The view's own part as a share of the processor time of training without it, by medians."""
        return median(self.own_s[which]) / median(self.cpu_s[ALONE])


class _Timed:
    """A view whose calls are timed.

    Attributes:
        spent: Processor time of its calls, s.
    """

    def __init__(self, view: LiveView) -> None:
        self._view, self.spent = view, 0.0

    def after_step(self) -> None:
        begin = time.thread_time()
        self._view.after_step()
        self.spent += time.thread_time() - begin

    def after_iteration(self, iteration: int, values: dict[str, float]) -> None:
        begin = time.thread_time()
        self._view.after_iteration(iteration, values)
        self.spent += time.thread_time() - begin

    def close(self, finished: bool) -> None:
        self._view.close(finished)


def watch_cost(task: str, cfg: TaskCfg, rounds: int, iterations: int = 1) -> Cost:
    """Measures a task in this process; each round has some iterations of each of the three, in turning order."""
    seed_everything(cfg.env.seed)
    env = ManagerBasedRlEnv(cfg.env)
    trainer = Trainer(task, cfg, env, None, Console(quiet=True))
    trainer.start_episodes()
    trainer.iterate()
    measured: list[dict[str, list[float]]] = [{name: [] for name in (ALONE, UNSEEN, SEEN)} for _ in range(3)]
    wall, cpu, own = measured
    before = set(_threads())
    with live_view(env, WORLDS, _free_port(), _free_port(), "bench") as (live, _):
        view, nobody = _Timed(live), live.is_watched
        looks: dict[str, Callable[[float], bool] | None] = {ALONE: None, UNSEEN: nobody, SEEN: lambda now: True}

        def spent_by_view() -> float:
            return view.spent + sum(seconds for thread, seconds in _threads().items() if thread not in before)

        for i in range(rounds):
            names = list(looks)
            for name in names[i % 3 :] + names[: i % 3]:
                look = looks[name]
                trainer.onlookers = [] if look is None else [view]
                live.is_watched = look or nobody
                begin, cpu_begin, own_begin = time.perf_counter(), time.process_time(), spent_by_view()
                for _ in range(iterations):
                    values = trainer.iterate()
                    for onlooker in trainer.onlookers:
                        onlooker.after_iteration(trainer.iteration, values)
                wall[name].append((time.perf_counter() - begin) / iterations)
                cpu[name].append((time.process_time() - cpu_begin) / iterations)
                own[name].append((spent_by_view() - own_begin) / iterations)
        live.close(finished=True)
    return Cost(env.num_envs, wall, cpu, own, live.sent / (rounds * iterations))


def cost_table(results: list[Cost]) -> Table:
    """The figures of each number of envs."""
    table = Table(title="Cost of a live view", box=SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
    table.caption = (
        "medians over rounds of an iteration; on a machine that others use go by the view's own processor time: that "
        "of its calls and of its threads"
    )
    for column in ("envs", "--watch", "wall s", "more", "CPU s", "more", "own CPU s", "share", "pictures"):
        table.add_column(column, justify="left" if column == "--watch" else "right", no_wrap=True)
    for r in results:
        for name in (ALONE, UNSEEN, SEEN):
            more = ["", ""] if name == ALONE else [f"{r.overhead(name, m):+.1%}" for m in (r.wall_s, r.cpu_s)]
            pictures = f"{r.pictures:.1f}" if name == SEEN else ""
            figures = f"{median(r.wall_s[name]):.3f}", more[0], f"{median(r.cpu_s[name]):.3f}", more[1]
            own = f"{median(r.own_s[name]):.4f}", f"{r.own_share(name):.2%}"
            table.add_row(str(r.num_envs), name, *figures, *own, pictures)
    return table


def _threads() -> dict[str, float]:
    """Processor time of every thread of this process by its number, s; empty where the system does not tell."""
    found = {}
    for path in Path("/proc/self/task").glob("*/schedstat"):
        with suppress(OSError):  # it has ended
            found[path.parent.name] = float(path.read_text(encoding="ascii").split()[0]) / 1e9
    return found


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
