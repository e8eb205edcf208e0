"""`humoslope bench TASK`: speed of a task on this machine, and its overhead over the bare physics."""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
import platform
import sys
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from statistics import median
from typing import Annotated, Any, ClassVar

from rich.console import Console
from rich.table import Table

import humoslope
from humoslope.cli.options import named_task, parse
from humoslope.cpu import usable_cores
from humoslope.errors import UserError
from humoslope.files import check_place
from humoslope.interrupts import leave_signals_to_parent
from humoslope.learning import checkpoint as checkpoints
from humoslope.learning.benchmark import RANDOM_STD, Measurement, measure
from humoslope.presets import Preset
from humoslope.ranges import Checked, Count, NotEmpty
from humoslope.registry import load_content
from humoslope.seal import finite, write_json

TARGETS = "Aims of the cpu preset: env.step 80 % and PPO 45 % of raw at 512 envs; below 2,048 MiB at 4096."


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Measures bare physics, env.step, the terrain descriptor and the whole PPO loop in turn. All speeds are control
    steps of all envs per second; the bare physics is given the states and controls that env.step went through.

    Attributes:
        sizes: Numbers of envs. Each is measured in a process of its own, so that its peak memory is its own.
        rounds: Number of measurements of each; medians are shown.
        preset: Scale of everything but the number of envs; "auto" for the one that fits the machine.
        checkpoint: Path of a checkpoint whose actor drives the robots, so that they touch the ground as in walking. By
            default actions are random.
        out: Path of a JSON file for the results; by default none is written.
        watch: Measure what `train --watch` costs instead: iterations with and without a live view in turn.
    """

    VERB: ClassVar[str] = "bench"

    sizes: Annotated[tuple[Count, ...], NotEmpty()] = (64, 256, 512, 1024, 4096)
    rounds: Count = 5
    preset: Preset = "auto"
    checkpoint: str = ""
    out: str = ""
    watch: bool = False


def run(arguments: list[str]) -> None:
    """Measures the task named in `arguments`."""
    named = named_task("bench", arguments)
    if named is None:
        return
    task, typed = named
    _, options = parse(Options(), task, typed, "bench")
    if options.checkpoint:
        checkpoints.load(Path(options.checkpoint))
    if options.out:
        check_place(Path(options.out))

    console = Console(width=None if sys.stdout.isatty() else 100)
    if options.watch:
        _measure_watching(task, typed, options, console)
        return
    driver = f"the actor of {options.checkpoint}" if options.checkpoint else f"random actions of std {RANDOM_STD:g}"
    load = os.getloadavg()[0]
    console.print(
        f"{task}, preset {options.preset}, driven by {driver}; {usable_cores()} cores, load {load:.1f} before.",
        soft_wrap=True,
        highlight=False,
    )
    results = []
    for size in sorted(options.sizes):
        results.append(_measure_apart(task, typed, size))
        console.print(f"  {size} envs: {median(results[-1].env):,.0f} steps/s", highlight=False)
    if options.out:
        report = _report(task, typed, options, driver, load, results)
        write_json(Path(options.out), finite(report))
    console.print(speed_table(results, options.preset), descriptor_table(results), parts_table(results))
    if options.out:
        console.print(f"wrote {options.out}", soft_wrap=True)


def _measure_watching(task: str, typed: list[str], options: Options, console: Console) -> None:
    from humoslope.replay.rerun.live_cost import cost_table, watch_cost  # loads the viewer, which takes a while

    costs = []
    for size in sorted(options.sizes):
        cfg, _ = parse(Options(), task, typed, "bench")
        cfg.env.num_envs = size
        costs.append(watch_cost(task, cfg, options.rounds))
    if options.out:
        told = {"what": "watch", "task": task, "options": typed, "sizes": [dataclasses.asdict(cost) for cost in costs]}
        write_json(Path(options.out), finite(told))
    console.print(cost_table(costs))


def _measure_apart(task: str, typed: list[str], num_envs: int) -> Measurement:
    # A fresh interpreter: a forked one would start with this one's memory.
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), leave_signals_to_parent) as pool:
        try:
            return pool.submit(_measure, task, typed, num_envs).result()
        except BrokenProcessPool:
            raise UserError(f"the process with {num_envs} envs was killed; probably memory ran out.") from None
        except KeyboardInterrupt:  # the pool would wait for the end of the measurement
            for process in multiprocessing.active_children():
                process.kill()
            raise


def _measure(task: str, typed: list[str], num_envs: int) -> Measurement:
    load_content()
    cfg, options = parse(Options(), task, typed, "bench")
    cfg.env.num_envs = num_envs
    return measure(task, cfg, options.rounds, Path(options.checkpoint) if options.checkpoint else None)


def speed_table(results: list[Measurement], preset: Preset) -> Table:
    """Table of speed and memory with a row for each number of envs."""
    reference = next((r for r in results if r.num_envs == 256), results[0])
    caption = (
        f"collect, learn: ms of a PPO iteration. cost: of one env's env.step, relative to {reference.num_envs} envs."
    )
    on_card = results[0].card_mib is not None
    title = f"Control steps of all envs per second, {results[0].device}"
    table = Table(title=title, caption=f"{caption}\n{TARGETS}" if preset == "cpu" and not on_card else caption)
    memory = ("MiB", "card MiB") if on_card else ("MiB",)
    for column in ("envs", "raw", "env.step", "of raw", "PPO", "of raw", "collect", "learn", *memory, "cost"):
        table.add_column(column, justify="right")
    for r in results:
        table.add_row(
            str(r.num_envs),
            f"{median(r.raw):,.0f}",
            f"{median(r.env):,.0f}",
            f"{_share(r.env, r.raw):.0%}",
            f"{median(r.ppo):,.0f}",
            f"{_share(r.ppo, r.raw):.0%}",
            f"{1e3 * median(r.collection_s):,.0f}",
            f"{1e3 * median(r.learning_s):,.0f}",
            f"{r.peak_mib:,.0f}",
            *([] if r.card_mib is None else [f"{r.card_mib:,.0f}"]),
            f"{median(reference.env) / median(r.env):.2f}",
        )
    return table


def descriptor_table(results: list[Measurement]) -> Table:
    """Table of the cost of the terrain descriptor, which is measured even if the task does not read it."""
    title = "Scan and terrain descriptor"
    table = Table("envs", "ms a step", "of raw", title=title, caption="of raw: share of the bare physics' step")
    for r in results:
        share = median(s * raw / r.num_envs for s, raw in zip(r.descriptor_s, r.raw, strict=True))
        table.add_row(str(r.num_envs), f"{1e3 * median(r.descriptor_s):.2f}", f"{share:.1%}")
    return table


def parts_table(results: list[Measurement]) -> Table:
    """Table of the shares of time in `env.step`, at the measured number of envs that is nearest to 512."""
    result = min(results, key=lambda r: abs(r.num_envs - 512))
    table = Table("part", "share", title=f"env.step with {result.num_envs} envs")
    for part, share in result.parts.items():
        table.add_row(part, f"{share:.1%}")
    return table


def _share(some: list[float], whole: list[float]) -> float:
    return median(a / b for a, b in zip(some, whole, strict=True))


def _report(
    task: str, typed: list[str], options: Options, driver: str, load: float, results: list[Measurement]
) -> dict[str, Any]:
    return {
        "what": "bench",
        "version": humoslope.__version__,
        "task": task,
        "options": typed,
        "driver": driver,
        "preset": options.preset,
        "machine": {
            "platform": platform.platform(),
            "cores": usable_cores(),
            "load_before": load,
            "device": results[0].device,
        },
        "unit": "control steps of all envs per second; one value for each round",
        "sizes": [dataclasses.asdict(r) for r in results],
    }
