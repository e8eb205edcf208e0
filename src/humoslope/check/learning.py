"""Checks of speed, and of a short training that goes on from a trained policy."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from statistics import fmean, median

from rich.console import Console

from humoslope.check.finding import Finding, at_least, below
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.learning import checkpoint as checkpoints
from humoslope.learning.benchmark import Measurement, measure
from humoslope.learning.configuration import trained_cfg
from humoslope.learning.rng import seed_everything
from humoslope.learning.trainer import Trainer
from humoslope.presets import apply_preset
from humoslope.registry import TaskCfg, build_task
from humoslope.seal import beside, check_sums

ENV_SHARE, LOOP_SHARE = 0.4, 0.15
"""Least speed of env.step and of the whole training loop, as shares of the bare physics, at the largest size."""

SETTLING = 3
"""Iterations after a start that count for nothing: every episode begins anew."""
LAST = 100
"""Rows at the end of a curve whose mean is compared."""
REWARD_SHARE = 0.75
"""Least reward per second, of the curve's: over a few iterations the mean scatters by a tenth."""
FALLS = 0.1
"""Most falls per env and second above the curve's; a policy that is thrown by wrong contacts falls at 0.3 and more."""


def check_speed(
    task: str, cfg: TaskCfg, sizes: tuple[int, ...], rounds: int
) -> tuple[list[Finding], list[Measurement]]:
    """Control steps per second of bare physics, env.step and the training loop for several numbers of envs."""
    findings, results = [], []
    for size in sizes:
        sized = replace(cfg, env=replace(cfg.env, num_envs=size))
        result = measure(task, sized, rounds)
        raw, env, loop = (median(values) for values in (result.raw, result.env, result.ppo))
        card = "" if result.card_mib is None else f"; card {result.card_mib:,.0f} MiB"
        speeds = f"raw {raw:,.0f}, env.step {env:,.0f}, training {loop:,.0f} steps/s{card}"
        findings.append(Finding(f"{size} envs", speeds))
        results.append(result)
    last = results[-1]
    env_share = median(env / raw for env, raw in zip(last.env, last.raw, strict=True))
    loop_share = median(loop / raw for loop, raw in zip(last.ppo, last.raw, strict=True))
    findings.append(at_least(f"{last.num_envs} envs, env.step of raw", env_share, ENV_SHARE))
    findings.append(at_least(f"{last.num_envs} envs, training of raw", loop_share, LOOP_SHARE))
    return findings, results


def check_training(
    task: str, cfg: TaskCfg, iterations: int, checkpoint: Path | None, curve: Path | None
) -> list[Finding]:
    """A short training, which must not diverge. Continued from a checkpoint, it is compared with the end of that run's
    curve: after equally many samples the reward must be as high and falls as rare.

    Args:
        cfg: Physics and number of envs.
        iterations: Length; the first few are left out where a curve is compared.
    """
    if checkpoint is not None:
        env_cfg = cfg.env
        cfg = continued_cfg(checkpoint, task)
        # The checkpoint's own task and physics step, on this device.
        sim = replace(
            cfg.env.sim,
            backend=env_cfg.sim.backend,
            device=env_cfg.sim.device,
            nconmax=env_cfg.sim.nconmax,
            njmax=env_cfg.sim.njmax,
        )
        cfg = replace(cfg, env=replace(cfg.env, num_envs=env_cfg.num_envs, sim=sim))
    rows = train(task, cfg, iterations, checkpoint)
    diverged = sum(row["Train/diverged"] for row in rows)
    samples = f"{rows[-1]['Perf/total_steps'] / 1e6:.2f} M samples"
    subject = f"{len(rows)} iterations to {samples}"
    findings = [Finding(f"{subject}, diverged", f"{diverged:g}", "0", diverged == 0.0)]
    kept = rows[SETTLING:] or rows
    reward, falls = (fmean(row[name] for row in kept) for name in ("Train/reward", "Train/falls_per_second"))
    if checkpoint is None or curve is None:
        return [*findings, Finding(f"{subject}, reward", f"{reward:.3g} per second")]
    end = read_end(curve)
    least = REWARD_SHARE * end["Train/reward"]
    return [
        *findings,
        Finding(f"{subject}, reward", f"{reward:.3g} per second", f"at least {least:.3g}", reward >= least),
        below(f"{subject}, falls", falls, end["Train/falls_per_second"] + FALLS, "per env and second"),
    ]


def train(task: str, cfg: TaskCfg, iterations: int, checkpoint: Path | None) -> list[dict[str, float]]:
    """Points of every curve of some iterations, from nothing or continued from a checkpoint of the same task."""
    seed_everything(cfg.env.seed)
    trainer = Trainer(task, cfg, ManagerBasedRlEnv(cfg.env), None, Console(quiet=True))
    if checkpoint is not None:
        trainer.resume(checkpoint)
    trainer.start_episodes()
    return [trainer.iterate() for _ in range(iterations)]


def continued_cfg(path: Path, task: str) -> TaskCfg:
    """The configuration that a checkpoint was trained with; checkpoints of the first format do not hold it, and were
    trained with the CPU preset."""
    state = checkpoints.load(path, task)
    if state["config"] is not None:
        return trained_cfg(path, state)
    cfg = build_task(task)
    apply_preset(cfg, "cpu")
    return cfg


def read_end(curve: Path) -> dict[str, float]:
    """Means of the last rows of a curve, a table as `humoslope curve --table` writes it.

    Raises:
        UserError: If the file is no such table, or was damaged since.
    """
    wanted = ("Train/reward", "Train/falls_per_second")
    check_sums(curve.parent, "draw it anew from its run, or", beside(curve))
    try:
        with curve.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))[-LAST:]
        return {name: fmean(float(row[name]) for row in rows) for name in wanted}
    except OSError as error:
        raise UserError(f"curve '{curve}' cannot be read: {error.strerror}.") from None
    except (KeyError, TypeError, ValueError):
        raise UserError(f"'{curve}' is not a curve with {' and '.join(wanted)}; see humoslope curve --table.") from None
