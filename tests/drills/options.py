"""Values for every option of every task: each is refused in one sentence, or gives an environment that steps."""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import io
import math
import random
import signal
import traceback
from collections.abc import Iterator, Mapping
from types import FrameType
from typing import Any, NamedTuple

import torch
from rich.console import Console

from humoslope.cli.options import parse
from humoslope.cli.train import TrainArgs
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.learning.trainer import Trainer
from humoslope.managers import TermCfg
from humoslope.registry import TaskCfg, all_tasks, build_task
from humoslope.scene.robot import Robot
from tests.drills.report import Drill

SMALL = [
    *("--preset", "cpu", "--env.num-envs", "2", "--env.sim.device", "cpu", "--env.sim.num-threads", "1"),
    *("--env.scene.terrain.levels", "2", "--env.scene.terrain.num-columns", "8"),
    *("--agent.num-steps-per-env", "4", "--agent.num-mini-batches", "2", "--agent.num-learning-epochs", "1"),
    *("--agent.hidden-dims", "8", "--agent.no-mixed-precision"),
]
STEPS = 10
LONGEST_S = 300
"""Time after which a value hangs, s; most of it is for machines that do other things as well."""
BAD = ("nan", "inf", "-inf", "1e300", "-1e300", "1e-300", "99999999999", "-1", "0", "-0.5", "many", "", "ü✓", "1e9")
TEXTS = ("", "(", "nothing", "ü✓", ".*", "../..", "a b")


class Option(NamedTuple):
    """An option as typed, and the value that the task gives it."""

    name: str
    value: Any


def options_of(task: str) -> list[Option]:
    """Every option of a task that takes a value."""
    cfg = build_task(task)
    found = [Option(f"--{name}".replace("_", "-"), value) for name, value in _leaves(cfg)]
    return [option for option in found if option.value is None or isinstance(option.value, int | float | str | tuple)]


def fields_of(cfg: TaskCfg) -> list[tuple[Any, str, Any, str]]:
    """Holder, name, value and path of every number of a configuration, those of terms' params excepted."""
    found, waiting = [], [("env", cfg.env), ("agent", cfg.agent)]
    while waiting:
        path, thing = waiting.pop()
        for field in dataclasses.fields(thing):
            value, name = getattr(thing, field.name), f"{path}.{field.name}"
            if isinstance(value, Robot):
                continue
            if dataclasses.is_dataclass(value):
                waiting.append((name, value))
            elif isinstance(value, Mapping) and any(map(dataclasses.is_dataclass, value.values())):
                waiting += [(f"{name}.{key}", item) for key, item in value.items()]
            elif _is_number(value) or (isinstance(value, tuple) and value and all(map(_is_number, value))):
                found.append((thing, field.name, value, name))
    return found


def generate(count: int, seed: int, tasks: list[str] | None = None) -> Iterator[tuple[str, list[str]]]:
    """`count` times a task and options for it, of which the last one has a value to be judged."""
    rng = random.Random(seed)
    names = tasks or list(all_tasks())
    options = {task: options_of(task) for task in names}
    for _ in range(count):
        task = rng.choice(names)
        option = rng.choice(options[task])
        if rng.random() < 0.03:
            letters = list(option.name)
            letters[rng.randrange(2, len(letters))] = rng.choice("abcxyz")
            option = option._replace(name="".join(letters))
        yield task, [option.name, *_values(option.value, rng)]


def judge(task: str, options: list[str]) -> tuple[str, str]:
    """The answer to options, and what is wrong with it, "" if nothing."""
    said = io.StringIO()
    before = signal.signal(signal.SIGALRM, _hang)
    signal.alarm(LONGEST_S)
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            return _steps(task, options)
    except UserError as error:
        sentence = str(error)
        one = "\n" not in sentence and sentence.endswith((".", "?"))
        return "refused", "" if one and "not finite (" not in sentence else f"said: {sentence}"
    except SystemExit as stop:
        return "refused by the parser", "" if stop.code == 2 else f"exit code {stop.code}"
    except TimeoutError:
        return "hang", f"no answer within {LONGEST_S} s"
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return "traceback", f"{type(error).__name__}: {error} ({place.filename}:{place.lineno})"
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def drill(count: int, seed: int = 0, tasks: list[str] | None = None, progress: Any = None) -> Drill:
    """Judges `count` values."""
    result = Drill("options")
    for task, options in generate(count, seed, tasks):
        answer, fault = judge(task, options)
        result.add(answer, fault and f"{task} {' '.join(map(repr, options))}: {fault}")
        if progress:
            progress(result)
    return result


def _steps(task: str, options: list[str]) -> tuple[str, str]:
    cfg, _ = parse(TrainArgs(), task, [*SMALL, *options])
    cfg.agent.check()
    torch.manual_seed(0)
    env = ManagerBasedRlEnv(cfg.env)
    for _ in range(STEPS):
        obs, reward, _, _ = env.step(0.3 * torch.randn(env.num_envs, env.robot.num_joints))
        bad = [name for name, group in (*obs.items(), ("reward", reward)) if not bool(group.isfinite().all())]
        if bad:
            return "accepted", f"{', '.join(bad)} not finite"
    if options[0].startswith("--agent."):
        trainer = Trainer(task, cfg, env, None, Console(quiet=True))
        with contextlib.suppress(UserError):  # learning may diverge, and says so
            trainer.iterate()
    return "accepted", ""


def _hang(number: int, frame: FrameType | None) -> None:
    raise TimeoutError


def _leaves(cfg: TaskCfg) -> Iterator[tuple[str, Any]]:
    waiting: list[tuple[str, Any]] = [("env", cfg.env), ("agent", cfg.agent)]
    while waiting:
        path, thing = waiting.pop()
        if isinstance(thing, Robot):
            continue
        if isinstance(thing, TermCfg):
            parameters = inspect.signature(thing.func).parameters
            defaults = {k: p.default for k, p in parameters.items() if p.default is not inspect.Parameter.empty}
            waiting += [(f"{path}.params.{name}", value) for name, value in (defaults | thing.params).items()]
        if dataclasses.is_dataclass(thing):
            names = [field.name for field in dataclasses.fields(thing) if field.name not in ("func", "params")]
            waiting += [(f"{path}.{name}", getattr(thing, name)) for name in names]
        elif isinstance(thing, Mapping):
            waiting += [(f"{path}.{name}", value) for name, value in thing.items()]
        elif not isinstance(thing, bool) and not callable(thing):
            yield path, thing


def _values(value: Any, rng: random.Random) -> list[str]:
    if isinstance(value, str):
        return [rng.choice((*TEXTS, *BAD[:4]))]
    if isinstance(value, tuple):
        reversed_ = [str(v) for v in reversed(value)]
        several = [_number(v, rng) for v in value] if value else [_number(1, rng)]
        one_bad = [str(v) for v in value]
        if value:
            one_bad[rng.randrange(len(value))] = rng.choice(BAD)
        return rng.choice([reversed_, several, one_bad, [rng.choice(BAD)] * max(1, len(value)), one_bad[:-1], []])
    return [_number(value, rng)]


def _number(value: Any, rng: random.Random) -> str:
    if rng.random() < 0.6 or not _is_number(value):
        return rng.choice(BAD)
    scaled = (value or 1.0) * 10.0 ** rng.uniform(-3.0, 3.0) * rng.choice((1.0, 1.0, -1.0))
    return str(round(scaled)) if isinstance(value, int) else str(scaled)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
