"""What a live view costs a training: iterations with and without it in turn, in wall-clock and in processor time."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from humoslope.env import ManagerBasedRlEnv
from humoslope.learning.rng import seed_everything
from humoslope.learning.trainer import Trainer
from humoslope.registry import TaskCfg
from humoslope.replay.rerun.live import LiveView, live_view
from humoslope.replay.rerun.viewer import HOST

ALONE, UNSEEN, SEEN = "without --watch", "with it, nobody looks", "with it, as if somebody looked"
WORLDS = 4


@dataclass(frozen=True)
class Cost:
    """Seconds of training iterations.

    Attributes:
        num_envs: Number of envs.
        wall_s, cpu_s: By `ALONE`, `UNSEEN` and `SEEN`, a value for each round: wall-clock time, and processor time of
            training with all its threads. The viewer's server is a process of its own, and not in it.
        pictures: Pictures that were sent per iteration while somebody looked.
    """

    num_envs: int
    wall_s: dict[str, list[float]]
    cpu_s: dict[str, list[float]]
    pictures: float

    def overhead(self, which: str, measured: dict[str, list[float]]) -> float:
        """Median over rounds of the additional share of time that a view takes."""
        return median(a / b - 1.0 for a, b in zip(measured[which], measured[ALONE], strict=True))


def watch_cost(task: str, cfg: TaskCfg, rounds: int, iterations: int = 1) -> Cost:
    """Measures a task in this process; each round has some iterations of each of the three, in turning order."""
    seed_everything(cfg.env.seed)
    env = ManagerBasedRlEnv(cfg.env)
    trainer = Trainer(task, cfg, env, None, Console(quiet=True))
    trainer.start_episodes()
    trainer.iterate()
    wall: dict[str, list[float]] = {ALONE: [], UNSEEN: [], SEEN: []}
    cpu: dict[str, list[float]] = {name: [] for name in wall}
    with live_view(env, WORLDS, _free_port(), _free_port(), "bench") as (live, _):
        nobody = live.is_watched
        kinds: dict[str, tuple[LiveView | None, Callable[[float], bool]]] = {
            ALONE: (None, nobody),
            UNSEEN: (live, nobody),
            SEEN: (live, lambda now: True),
        }
        for i in range(rounds):
            names = list(kinds)
            for name in names[i % 3 :] + names[: i % 3]:
                view, live.is_watched = kinds[name]
                trainer.onlookers = [] if view is None else [view]
                begin, cpu_begin = time.perf_counter(), time.process_time()
                for _ in range(iterations):
                    values = trainer.iterate()
                    if view is not None:
                        view.after_iteration(trainer.iteration, values)
                wall[name].append((time.perf_counter() - begin) / iterations)
                cpu[name].append((time.process_time() - cpu_begin) / iterations)
        live.close(finished=True)
    return Cost(env.num_envs, wall, cpu, live.sent / (rounds * iterations))


def cost_table(results: list[Cost]) -> Table:
    """The figures of each number of envs."""
    table = Table(title="Cost of a live view", box=SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
    table.caption = "medians over rounds; processor time is the one to go by on a machine that others use"
    for column in ("envs", "", "wall s", "more", "processor s", "more", "pictures"):
        table.add_column(column, justify="left" if not column else "right", no_wrap=True)
    for r in results:
        for name in (ALONE, UNSEEN, SEEN):
            more = ["", ""] if name == ALONE else [f"{r.overhead(name, m):+.1%}" for m in (r.wall_s, r.cpu_s)]
            pictures = f"{r.pictures:.1f}" if name == SEEN else ""
            figures = f"{median(r.wall_s[name]):.3f}", more[0], f"{median(r.cpu_s[name]):.3f}", more[1]
            table.add_row(str(r.num_envs), name, *figures, pictures)
    return table


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
