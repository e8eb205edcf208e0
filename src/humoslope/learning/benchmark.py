"""Cost of a task over the bare physics: speed of physics, environment and learning, in turn, in one process."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from tensordict import TensorDict
from torch import Tensor

from humoslope.env import ManagerBasedRlEnv
from humoslope.learning.policy import load_actor
from humoslope.learning.rng import seed_everything
from humoslope.learning.trainer import Trainer
from humoslope.registry import TaskCfg
from humoslope.sim.device import describe_device
from humoslope.slope.descriptor import phi5

RANDOM_STD = 0.8
"""Standard deviation of the random actions, that of an untrained policy."""

BLOCK = 24
"""Control steps that raw physics, `env.step` and the terrain descriptor are each measured for in a round."""

STATE = ("qpos", "qvel", "ctrl", "xfrc_applied")

PARTS = {
    "physics": ("sim", "step"),
    "physics: resets": ("sim", "reset"),
    "signals": ("signals", "refresh"),
    "terminations": ("terminations", "compute"),
    "rewards": ("rewards", "compute"),
    "events, harness": ("events", "step"),
    "commands": ("commands", "step"),
    "observations": ("observations", "compute"),
}
"""Parts of `env.step` that are timed: where the method hangs, and its name. None calls another."""


@dataclass(frozen=True)
class Measurement:
    """Figures for one number of envs.

    Attributes:
        raw, env, ppo: Control steps of all envs per second, one value for each round.
        descriptor_s: Scan and terrain descriptor of all envs, once, s, one value for each round.
        collection_s, learning_s: The two halves of a PPO iteration, s.
        peak_mib: Largest host memory of the process through a whole PPO iteration, MiB.
        parts: Share of each part in the time of `env.step`.
        device: Name of the GPU with its memory and driver, or "CPU".
        card_mib: Memory of the GPU in use after the last PPO iteration, of all processes on it, MiB; None on a CPU.
    """

    num_envs: int
    raw: list[float]
    env: list[float]
    ppo: list[float]
    descriptor_s: list[float]
    collection_s: list[float]
    learning_s: list[float]
    peak_mib: float
    parts: dict[str, float]
    device: str = "CPU"
    card_mib: float | None = None


def measure(task: str, cfg: TaskCfg, rounds: int, checkpoint: Path | None = None) -> Measurement:
    """Measures a task in this process, in rounds of each of the four.

    Args:
        task: Its name.
        cfg: Its configuration.
        rounds: How often each of the four is measured.
        checkpoint: A trained actor that drives the robots; None for random actions.

    Raises:
        UserError: If the checkpoint does not fit the task.
    """
    seed_everything(cfg.env.seed)
    env = ManagerBasedRlEnv(cfg.env)
    trainer = Trainer(task, cfg, env, None, Console(quiet=True))
    act = _driver(checkpoint, env, trainer)

    trainer.start_episodes()
    trainer.iterate()
    peak = _peak_mib()
    with torch.inference_mode():  # as in a rollout
        _env_block(env, act)
    blocks, times = [], []
    for _ in range(rounds):
        with torch.inference_mode():
            env_s, frames = _env_block(env, act)
            descriptor_s = _descriptor_block(env)
            blocks.append((_raw_block(env, frames), env_s, descriptor_s))
        values = trainer.iterate()
        times.append((values["Perf/collection_time"], values["Perf/learning_time"]))
    with torch.inference_mode():
        parts = _parts(env, act)
    collection, learning = zip(*times, strict=True)
    num_envs = cfg.env.num_envs
    rollout = num_envs * cfg.agent.num_steps_per_env
    return Measurement(
        num_envs=num_envs,
        raw=[num_envs * BLOCK / raw_s for raw_s, _, _ in blocks],
        env=[num_envs * BLOCK / env_s for _, env_s, _ in blocks],
        ppo=[rollout / (c + u) for c, u in times],
        descriptor_s=[descriptor_s / BLOCK for _, _, descriptor_s in blocks],
        collection_s=list(collection),
        learning_s=list(learning),
        peak_mib=peak,
        parts=parts,
        device=describe_device(env.device),
        card_mib=_card_mib(env.device),
    )


def _driver(path: Path | None, env: ManagerBasedRlEnv, trainer: Trainer) -> Callable[[TensorDict], Tensor]:
    if path is None:
        return lambda _: RANDOM_STD * torch.randn(env.num_envs, env.robot.num_joints, device=env.device)
    trainer.warm_start(path)
    return load_actor(path, env)


def _now(env: ManagerBasedRlEnv) -> float:
    if env.device.type == "cuda":
        torch.cuda.synchronize(env.device)
    return time.perf_counter()


def _env_block(env: ManagerBasedRlEnv, act: Callable[[TensorDict], Tensor]) -> tuple[float, list[dict[str, Tensor]]]:
    """Time of a block of `env.step`, s, and what the physics was given in each step."""
    frames: list[dict[str, Tensor]] = []
    advance, spent = env.measurements.advance, 0.0

    def record(n: int, active: Tensor | None) -> None:
        nonlocal spent
        start = _now(env)
        frames.append({field: env.sim.state(field).clone() for field in STATE})
        spent -= _now(env) - start
        advance(n, active)

    with _hung(env.measurements, "advance", record):
        for _ in range(BLOCK):
            action = act(env.get_observations())
            start = _now(env)
            env.step(action)
            spent += _now(env) - start
    return spent, frames


def _raw_block(env: ManagerBasedRlEnv, frames: list[dict[str, Tensor]]) -> float:
    """Time of the physics alone, s, from the same states with the same controls."""
    after = {field: env.sim.state(field).clone() for field in STATE}
    spent = 0.0
    for frame in frames:
        for field, value in frame.items():
            env.sim.state(field).copy_(value)
        start = _now(env)
        env.sim.step(env.cfg.sim.decimation)
        spent += _now(env) - start
    for field, value in after.items():
        env.sim.state(field).copy_(value)
    return spent


def _descriptor_block(env: ManagerBasedRlEnv) -> float:
    """Time of a block of scans with their descriptors, s."""
    spent = 0.0
    for _ in range(BLOCK):
        env.signals.refresh()
        start = _now(env)
        phi5(env.height_scan.descriptor)
        spent += _now(env) - start
    return spent


def _parts(env: ManagerBasedRlEnv, act: Callable[[TensorDict], Tensor]) -> dict[str, float]:
    """Share of each part in the time of a block of `env.step`."""
    spent = dict.fromkeys(PARTS, 0.0)

    def timed(part: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def wrapper(*args: Any) -> Any:
            start = _now(env)
            result = call(*args)
            spent[part] += _now(env) - start
            return result

        return wrapper

    total = 0.0
    with ExitStack() as stack:
        for part, (owner, name) in PARTS.items():
            thing = getattr(env, owner)
            stack.enter_context(_hung(thing, name, timed(part, getattr(thing, name))))
        for _ in range(BLOCK):
            action = act(env.get_observations())
            start = _now(env)
            env.step(action)
            total += _now(env) - start
    return {part: seconds / total for part, seconds in spent.items()} | {"rest": 1.0 - sum(spent.values()) / total}


@contextmanager
def _hung(thing: object, name: str, function: Callable[..., Any]) -> Iterator[None]:
    """Puts `function` in place of a method of one object."""
    setattr(thing, name, function)
    try:
        yield
    finally:
        delattr(thing, name)


def _card_mib(device: torch.device) -> float | None:
    # Physics, captured graphs and torch have pools of their own, which keep what they once needed; only the card
    # itself knows their sum.
    if device.type != "cuda":
        return None
    free, total = torch.cuda.mem_get_info(device)
    return (total - free) / 2**20


def _peak_mib() -> float:
    try:
        # Unlike getrusage's, this one starts anew in a fresh process.
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024
    except (OSError, StopIteration):
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / (1024**2 if sys.platform == "darwin" else 1024)
