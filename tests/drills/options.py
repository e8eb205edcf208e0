"""Values for every option of every task: each is refused in one sentence, or gives an environment that steps."""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import io
import math
import random
import re
import resource
import signal
import traceback
from collections import Counter
from collections.abc import Iterator, Mapping
from types import FrameType
from typing import Any, NamedTuple, get_args

import torch
from rich.console import Console

from humoslope.cli.options import parse
from humoslope.cli.train import TrainArgs
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.learning.trainer import Trainer
from humoslope.managers import TermCfg
from humoslope.ranges import LARGEST, SMALLEST, Range, hints_of
from humoslope.registry import TaskCfg, all_tasks, build_task
from humoslope.scene.robot import Robot
from tests.drills.report import Drill

SMALL = [
    *("--preset", "cpu", "--env.num-envs", "2", "--env.sim.device", "cpu", "--env.sim.num-threads", "1"),
    *("--env.scene.terrain.levels", "2", "--env.scene.terrain.num-columns", "9"),
]
SMALL_AGENT = {
    "--agent.num-steps-per-env": ["4"],
    "--agent.hidden-dims": ["8"],
    "--agent.mixed-precision": [],
    # PPO
    "--agent.num-mini-batches": ["2"],
    "--agent.num-learning-epochs": ["1"],
    # FastTD3
    "--agent.critic-hidden-dims": ["8"],
    "--agent.num-updates": ["1"],
    "--agent.batch-size": ["16"],
    "--agent.buffer-steps": ["64"],
    "--agent.learning-starts": ["2"],
    "--agent.num-atoms": ["11"],
}
"""Values with which each learner is small and quick, for the options that it has; flags are turned off."""
STEPS = 10
MOST_WORK = 200
"""Largest product of an agent's numbers of steps, epochs and updates with which the drill also learns."""
LONGEST_S = 60
"""Time of this process after which a value hangs, s; what other processes take of the machine does not count."""
MOST_MEMORY = 8 * 2**30
"""Memory that a value may take, bytes; what wants more must be refused before it takes it."""

KINDS: dict[str, tuple[str, ...]] = {
    "wrong type": ("many", "True", "1.5", "[1]"),
    "negative": ("-1", "-0.5", "-1e-3"),
    "zero": ("0", "-0.0"),
    "NaN": ("nan",),
    "infinite": ("inf", "-inf"),
    "huge": ("1e300", "-1e300", "99999999999", "1e9", "1" + 400 * "0", "9" * 5000),
    "tiny": ("1e-300",),
    "empty": ("",),
    "unicode": ("ü✓", "\u202e1", "\uff11", "\n"),
}
"""Words in place of a number, by what is wrong with them."""
TEXTS = ("", "(", "nothing", "ü✓", ".*", "../..", "a b", "\n", "x" * 5000, "nan", "-1", "[")
OF_ANY = (*KINDS, "lowest", "highest", "beyond", "scaled", "unknown name", "too many", "too few")
OF_SEVERAL = (*OF_ANY, "reversed", "one wrong")


class Option(NamedTuple):
    """An option as typed, the value that the task gives it, and its declared range if it is a number with one."""

    name: str
    value: Any
    range: Range | None = None


def options_of(task: str) -> list[Option]:
    """Every option of a task, each with its value."""
    leaves = _leaves(build_task(task))
    found = [Option(f"--{name}".replace("_", "-"), value, range_in(hint)) for name, value, hint in leaves]
    return [option for option in found if option.value is None or isinstance(option.value, int | float | str | tuple)]


def small(task: str) -> list[str]:
    """Options with which a task is small and quick."""
    has = {option.name: option.value for option in options_of(task)}
    chosen = list(SMALL)
    for name, value in SMALL_AGENT.items():
        if name in has:
            chosen += [name, *value] if value else [name.replace("--agent.", "--agent.no-")]
    return chosen


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
    """`count` times a task and an option with a value to be judged.

    Every option gets its turn before one comes again, each time of another task that has it and with another kind of
    value, so that `count` values spread evenly over options, tasks and kinds.
    """
    rng = random.Random(seed)
    having: dict[str, dict[str, Option]] = {}
    for task in tasks or all_tasks():
        for option in options_of(task):
            having.setdefault(option.name, {})[task] = option
    names, used = sorted(having), Counter[str]()
    rng.shuffle(names)
    shift = {name: rng.randrange(len(OF_SEVERAL)) for name in names}
    for i in range(count):
        turn, name = i // len(names), names[i % len(names)]
        task = min(having[name], key=lambda task: (used[task], rng.random()))
        used[task] += 1
        yield task, _words(having[name][task], shift[name] + turn, rng)


def judge(task: str, options: list[str]) -> tuple[str, str]:
    """The answer to options, and what is wrong with it, "" if nothing."""
    said, fault = io.StringIO(), ""
    before = signal.signal(signal.SIGPROF, _hang)
    signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said), _limited_memory():
            answer, fault = _steps(task, options)
    except UserError as error:
        answer, sentence = "refused", str(error)
        if "\n" in sentence or not sentence.endswith((".", "?")) or not sentence.isprintable() or len(sentence) > 1000:
            fault = f"said: {sentence!r}"
    except SystemExit as stop:
        answer = "refused by the parser"
        if stop.code != 2:
            fault = f"exit code {stop.code}"
        elif not _speaks_of(said.getvalue(), options):
            fault = f"said nothing of it: {said.getvalue()!r}"
    except TimeoutError:
        answer, fault = "hang", f"no answer within {LONGEST_S} s"
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        answer, fault = "traceback", f"{type(error).__name__}: {error} ({place.filename}:{place.lineno})"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
    return answer, fault


def drill(first: int, last: int, seed: int = 0, tasks: list[str] | None = None) -> Drill:
    """Judges the values from `first` on and before `last`, of all that a seed generates."""
    result = Drill("options")
    for number, (task, options) in enumerate(generate(last, seed, tasks)):
        if number >= first:
            answer, fault = judge(task, options)
            result.add(answer, fault and f"{task} {' '.join(f'{word[:80]!r}' for word in options)}: {fault}")
    return result


def _steps(task: str, options: list[str]) -> tuple[str, str]:
    cfg, _ = parse(TrainArgs(), task, [*small(task), *options])
    cfg.agent.check()
    torch.manual_seed(0)
    env = ManagerBasedRlEnv(cfg.env)
    for _ in range(STEPS):
        obs, reward, _, _ = env.step(0.3 * torch.randn(env.num_envs, env.robot.num_joints))
        bad = [name for name, group in (*obs.items(), ("reward", reward)) if not bool(group.isfinite().all())]
        if bad:
            return "accepted", f"{', '.join(bad)} not finite"
    if any(option.startswith("--agent.") for option in options):
        trainer = Trainer(task, cfg, env, None, Console(quiet=True))
        if _work_of(cfg.agent) <= MOST_WORK:
            with contextlib.suppress(UserError):  # learning may diverge, and says so
                trainer.iterate()
    return "accepted", ""


def _work_of(agent: Any) -> float:
    """How much an iteration does, in passes through networks as large as `small` makes them."""
    numbers = ("num_steps_per_env", "num_learning_epochs", "num_updates", "n_step")
    work = math.prod(getattr(agent, name, 1) for name in numbers) * getattr(agent, "batch_size", 16) / 16
    if getattr(agent, "torch_compile", False):
        return math.inf  # compiling takes minutes
    return work * max(1.0, sum(agent.hidden_dims) / 1000) ** 2  # type: ignore[no-any-return]


@contextlib.contextmanager
def _limited_memory() -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_AS)
    with open("/proc/self/statm", encoding="ascii") as file:
        taken = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + MOST_MEMORY, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def _speaks_of(said: str, options: list[str]) -> bool:
    """True if a message of the parser, which is broken into lines in a box, has the option or a word that it got."""
    squeezed = re.sub(r"[^\w.-]", "", said)
    return any(re.sub(r"[^\w.-]", "", word)[:40] in squeezed for word in options)


def _hang(number: int, frame: FrameType | None) -> None:
    raise TimeoutError


def range_in(hint: Any) -> Range | None:
    """The range that a type hint declares for a number, or for each of several."""
    for part in getattr(hint, "__metadata__", ()):
        if isinstance(part, Range):
            return part
    return next((found for part in get_args(hint) if (found := range_in(part))), None)


def _leaves(cfg: TaskCfg) -> Iterator[tuple[str, Any, Any]]:
    """Path, value and type hint of everything that an option can set."""
    waiting: list[tuple[str, Any, Any]] = [("env", cfg.env, None), ("agent", cfg.agent, None)]
    while waiting:
        path, thing, hint = waiting.pop()
        if isinstance(thing, Robot):
            continue
        if isinstance(thing, TermCfg):
            parameters = inspect.signature(thing.func).parameters
            defaults = {k: p.default for k, p in parameters.items() if p.default is not inspect.Parameter.empty}
            hints = hints_of(thing.func)
            values = (defaults | thing.params).items()
            waiting += [(f"{path}.params.{name}", value, hints.get(name)) for name, value in values]
        if dataclasses.is_dataclass(thing):
            names = [field.name for field in dataclasses.fields(thing) if field.name not in ("func", "params")]
            hints = hints_of(type(thing))
            waiting += [(f"{path}.{name}", getattr(thing, name), hints.get(name)) for name in names]
        elif isinstance(thing, Mapping):
            waiting += [(f"{path}.{name}", value, hint) for name, value in thing.items()]
        elif not callable(thing):
            yield path, thing, hint


def _words(option: Option, turn: int, rng: random.Random) -> list[str]:
    """An option as typed, with a value of the kind whose turn it is."""
    name, value, bounds = option
    kinds = OF_SEVERAL if isinstance(value, tuple) else OF_ANY
    kind = kinds[turn % len(kinds)]
    written = _written(value)
    changed = {"too many": [*written, "1", "2"], "too few": written[:-1], "reversed": written[::-1]}
    if kind == "unknown name":
        letters = list(name)
        letters[rng.randrange(2, len(letters))] = rng.choice("abcxyzü")
        name, words = "".join(letters), [] if isinstance(value, bool) else written
    elif kind in changed:
        words = changed[kind]
    elif isinstance(value, bool) and kind not in KINDS:
        *path, last = name.removeprefix("--").split(".")
        name, words = rng.choice((name, f"--{'.'.join([*path, f'no-{last}'])}")), []
    elif isinstance(value, str):
        words = [rng.choice(TEXTS)]
    elif kind == "scaled":
        words = [_scaled(v, rng) for v in (value if isinstance(value, tuple) and value else (value,))]
    elif kind == "one wrong":
        words = written or ["1"]
        words[rng.randrange(len(words))] = rng.choice(KINDS[rng.choice(list(KINDS))])
    elif kind in KINDS:
        words = [rng.choice(KINDS[kind])] * max(1, len(written))
    else:
        words = [_bound(kind, bounds or Range(), isinstance(value, int))] * max(1, len(written))
    return [name, *words]


def _bound(kind: str, bounds: Range, whole: bool) -> str:
    """The lowest or highest number of a range, or one just beyond it."""
    low = bounds.low if math.isfinite(bounds.low) else -LARGEST
    high = bounds.high if math.isfinite(bounds.high) else LARGEST
    step = 1.0 if whole else max(SMALLEST, 1e-6 * (high - low))
    number = {
        "lowest": low + step if bounds.open_low else low,
        "highest": high - step if bounds.open_high else high,
        "beyond": high + step,
    }[kind]
    return str(round(number) if whole else number)


def _written(value: Any) -> list[str]:
    return [str(v) for v in value] if isinstance(value, tuple) else [str(value)]


def _scaled(value: Any, rng: random.Random) -> str:
    number = value if _is_number(value) else 1.0
    scaled = (number or 1.0) * 10.0 ** rng.uniform(-3.0, 3.0) * rng.choice((1.0, 1.0, -1.0))
    return str(round(scaled)) if isinstance(value, int) else str(scaled)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
