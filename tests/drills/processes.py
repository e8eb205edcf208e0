"""Runs in processes of their own that are killed, stopped or run out of room, and what is left of them."""

from __future__ import annotations

import os
import random
import resource
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from humoslope.cli import main
from humoslope.errors import UserError
from humoslope.files import TEMPORARY
from humoslope.learning import checkpoint
from tests.drills.report import Drill

TASK = "HumoSlope-Stage1-Unitree-G1"
TINY = [
    *("--preset", "cpu", "--env.num-envs", "8", "--env.sim.device", "cpu", "--env.sim.num-threads", "1"),
    *("--env.scene.terrain.levels", "3", "--env.scene.terrain.num-columns", "9"),
    *("--agent.num-steps-per-env", "4", "--agent.num-mini-batches", "2", "--agent.num-learning-epochs", "1"),
    *("--agent.hidden-dims", "16", "16", "--agent.save-interval", "2", "--agent.no-mixed-precision"),
]
PATIENCE_S = 1800.0
"""Time after which a process hangs, s; most of it is for machines that do other things as well."""
KILLS, SIGNALS, ROOMS = "SIGKILL, then resume", "INT, TERM, HUP, then resume", "no room for a file"
"""Names of the drills."""


def forked(work: Callable[[], int]) -> int:
    """Starts `work` in a child that has all imports of this process; returns its id."""
    sys.stdout.flush()
    child = os.fork()
    if child:
        return child
    code = 70
    # As if started in the foreground: under nohup, or in the background of a script, signals would be ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    try:
        null = os.open(os.devnull, os.O_RDWR)
        for stream in (1, 2):
            os.dup2(null, stream)
        code = work()
    except SystemExit as stop:
        code = int(stop.code or 0)
    finally:
        os._exit(code)


def ended(child: int) -> int | None:
    """The exit code of a child, the negative signal that killed it, or None if it hung and was killed here."""
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.02)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def train(run: Path, iterations: int, *options: str) -> int:
    """Trains to an iteration, in a new run or on with an old one."""
    new = [*TINY, *options, "--run-dir", str(run)]
    resumed = ["--resume", str(run)] if any(run.glob("model_*.pt")) else new
    return main(["train", TASK, *resumed, "--agent.max-iterations", str(iterations)])


def newest(run: Path) -> int:
    """The iteration of the newest checkpoint, -1 if there is none."""
    try:
        return int(checkpoint.latest(run).stem.removeprefix("model_"))
    except UserError:
        return -1


def leftovers(run: Path) -> list[str]:
    """Names of temporary files in a run folder."""
    return [path.name for path in run.rglob(".*") if TEMPORARY.fullmatch(path.name)]


def differences(first: Path, second: Path) -> list[str]:
    """Names of the values in which two checkpoints differ, time and options apart."""
    a, b = (dict(_leaves(checkpoint.load(path))) for path in (first, second))
    names = [name for name in a if not name.startswith((".total_time", ".config.agent.max_iterations"))]
    return [name for name in names if name not in b or not _same(a[name], b[name])]


def drill_kills(folder: Path, count: int, seed: int = 0, last: int = 60) -> Drill:
    """Kills a run at random moments, goes on with it each time, and compares it with one that was never stopped."""
    result, rng = Drill(KILLS), random.Random(seed)
    whole, run = folder / "whole", folder / "killed"
    assert ended(forked(lambda: train(whole, last))) == 0
    for _ in range(count):
        before = newest(run)
        child = forked(lambda: train(run, last))
        wanted, until = before + rng.choice((1, 2, 4)), time.monotonic() + PATIENCE_S
        while newest(run) < min(wanted, last - 1) and time.monotonic() < until:
            time.sleep(0.002)
        time.sleep(rng.random() * 0.2)
        os.kill(child, signal.SIGKILL)
        ended(child)
        if newest(run) < 0:
            result.add("before the first checkpoint")
            for path in sorted(run.rglob("*"), reverse=True):
                path.unlink() if path.is_file() else path.rmdir()
            continue
        try:
            checkpoint.load(checkpoint.latest(run), TASK)
        except UserError as error:
            result.add("broken checkpoint", str(error))
            continue
        result.add("resumed", "" if newest(run) >= before else "an older checkpoint")
    code = ended(forked(lambda: train(run, last)))
    result.add("finished", "" if code == 0 else f"the last resume ended with {code}")
    if left := leftovers(run):
        result.failures.append(f"left behind: {left}")
    if differ := differences(whole / f"model_{last - 1}.pt", run / f"model_{last - 1}.pt"):
        result.failures.append(f"differs from the run that was never stopped in {differ[:3]} and {len(differ)} in all")
    return result


def drill_signal(folder: Path, i: int) -> Drill:
    """Stops a run by one of the signals, and goes on with it."""
    result, number, run = Drill(SIGNALS), (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)[i % 3], folder / f"stopped_{i}"
    child = forked(lambda: train(run, 1_000_000, "--agent.save-interval", "1000000"))
    until = time.monotonic() + PATIENCE_S
    while newest(run) < 0 and time.monotonic() < until:
        time.sleep(0.01)
    time.sleep(0.3)
    os.kill(child, number)
    code, at = ended(child), newest(run)
    fault = "" if code == 128 + number else f"{number.name} gave exit code {code}"
    fault = fault or ("" if at > 0 and not leftovers(run) else f"newest is {at}, left behind {leftovers(run)}")
    fault = fault or ("" if ended(forked(lambda: train(run, at + 3))) == 0 else "does not resume")
    result.add(f"exit code {code}", fault)
    return result


def drill_room(folder: Path, i: int) -> Drill:
    """Lets a run meet a limit on the size of files, as a full disk is one; each `i` meets it at another place."""
    result, run = Drill(ROOMS), folder / f"full_{i}"
    assert ended(forked(lambda: train(run, 3))) == 0
    before = {path: path.read_bytes() for path in run.glob("model_*.pt")}
    size = 1000 + 40_000 * i

    def limited() -> int:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        return train(run, 9)

    code = ended(forked(limited))
    whole = all(path.read_bytes() == content for path, content in before.items())
    fault = "" if code in (0, 2) else f"exit code {code}"
    fault = fault or ("" if whole else "an earlier checkpoint has changed")
    result.add(f"exit code {code}", fault or (f"left behind {leftovers(run)}" if leftovers(run) else ""))
    return result


def _leaves(value: Any, path: str = "") -> list[tuple[str, Any]]:
    if isinstance(value, dict):
        return [pair for name, child in value.items() for pair in _leaves(child, f"{path}.{name}")]
    if isinstance(value, list | tuple):
        return [pair for i, child in enumerate(value) for pair in _leaves(child, f"{path}[{i}]")]
    return [(path, value)]


def _same(a: Any, b: Any) -> bool:
    return torch.equal(a, b) if isinstance(a, torch.Tensor) else bool(a == b)
