"""Trials of a policy that walks, made to fail in known ways: each is put down to what was done to it."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from humoslope.check.host_sync import NoHostSync
from humoslope.cli.measure import trained
from humoslope.env import ManagerBasedRlEnv
from humoslope.evaluation import causes
from humoslope.evaluation.moments import window_steps
from humoslope.evaluation.report.results import from_report, to_report
from humoslope.evaluation.report.tables import causes_table
from humoslope.evaluation.track import store
from humoslope.evaluation.track.protocol import HeldOutProtocol
from humoslope.evaluation.track.trials import HeldOutTrials, TrialScheduler, held_out_env_cfg, run_trials
from humoslope.learning.policy import load_actor, read_spec
from tests.evaluation.made_up import report

PROTOCOL = HeldOutProtocol(grades=(20.0,), tiers=(0.0, 0.6), trials=3, start_place=3.5, timeout_s=3.5)
"""Trials that start on a slope: three with no more friction than standing still needs, and three others."""
WEAK, UNDISTURBED, PUSHED = 3, 4, 5
DT = 0.02


@pytest.fixture(scope="module")
def trials(stage1_checkpoint: Path) -> HeldOutTrials:
    """Of the others, one has motors of a third of their torque, one has too little time, and one is pushed."""
    _, task = trained(stage1_checkpoint)
    scheduler = TrialScheduler(PROTOCOL, PROTOCOL.find_course(), parallel_trials=3)
    env = ManagerBasedRlEnv(held_out_env_cfg(task.env, scheduler, read_spec(stage1_checkpoint).groups))
    third = torch.full((6, 29), 1.0 / 3.0)
    # The gains are as before, so that the motors' limit alone differs.
    gains = {"stiffness": 3.0 * env.drives.stiffness, "damping": 3.0 * env.drives.damping}
    env.drives.set(torch.arange(6) == WEAK, strength=third, **gains)

    def push(running: Tensor) -> None:
        if int(env.episode_length_buf[PUSHED]) == 100:  # it has found its gait
            env.sim.state("qvel")[PUSHED, 1] += 2.5  # to its left

    read, add = scheduler._read_moment, scheduler._moments.add

    def without_waiting(*arguments: Any) -> None:
        with NoHostSync():
            add(*arguments)

    def read_without_waiting(env: ManagerBasedRlEnv) -> Tensor:
        with NoHostSync():
            return read(env)

    scheduler._read_moment, scheduler._moments.add = read_without_waiting, without_waiting  # type: ignore
    return run_trials(env, load_actor(stage1_checkpoint, env), scheduler, push)


def test_each_failure_is_put_down_to_what_was_done(trials: HeldOutTrials) -> None:
    found = trials.causes(DT)
    assert {found[i] for i in range(3) if trials.fell[i]} == {causes.SLIP}
    assert trials.fell[:3].sum() >= 2
    assert found[WEAK] == causes.TORQUE
    assert found[PUSHED] == causes.TIP
    assert found[UNDISTURBED] == causes.OUT_OF_TIME


def test_only_the_last_moments_of_falls_are_kept(trials: HeldOutTrials) -> None:
    tilt = trials.moments["tilt"]
    assert tilt.shape == (6, window_steps(DT))
    assert tilt.dtype == np.float16
    assert np.isfinite(tilt[:, -1]).tolist() == trials.fell.tolist()
    assert np.isnan(tilt[UNDISTURBED]).all()
    for i in np.flatnonzero(trials.fell):
        assert np.isfinite(tilt[i]).sum() == min(window_steps(DT), round(trials.seconds[i] / DT))
    assert np.nanmax(trials.moments["friction"][PUSHED]) == np.float16(math.tan(math.radians(20.0)) + 0.6)


def test_causes_are_the_same_from_the_saved_trials_and_those_of_older_files_are_not_recorded(
    trials: HeldOutTrials, tmp_path: Path
) -> None:
    path = tmp_path / "trials.npz"
    store.save(path, store.SavedTrials(trials, 1.0, ()), "mark", PROTOCOL)
    kept = store.load(path, "mark", PROTOCOL)
    assert kept is not None
    assert kept.trials.causes(DT) == trials.causes(DT)

    with np.load(path) as archive:
        older = {name: archive[name] for name in archive.files if not name.startswith("moments.")}
    np.savez(path, **older)
    old = store.load(path, "mark", PROTOCOL)
    assert old is not None
    assert {cause for cause, fell in zip(old.trials.causes(DT), trials.fell, strict=True) if fell} == {
        causes.UNRECORDED
    }
    # An evaluation that goes on from it has both.
    new = trials.with_moments(window_steps(DT))
    store.save(path, store.SavedTrials(new, 1.0, ()), "mark", PROTOCOL)
    again = store.load(path, "mark", PROTOCOL)
    assert again is not None
    assert again.trials.causes(DT) == trials.causes(DT)
    resumed = TrialScheduler(PROTOCOL, PROTOCOL.find_course(), 3, old.trials)
    assert resumed.earlier is not None
    assert resumed.earlier.with_moments(window_steps(DT)).moments["tilt"].shape == (6, window_steps(DT))


def test_causes_are_counted_by_grade_in_report_and_table(trials: HeldOutTrials) -> None:
    told = to_report(
        trials,
        grades=PROTOCOL.grades,
        tiers=PROTOCOL.tiers,
        segments=PROTOCOL.find_course().segments,
        speed=0.5,
        mass=33.0,
        causes=trials.causes(DT),
    )
    counts = told["grades"][0]["causes"]
    assert counts == causes.count(trials.causes(DT))
    assert sum(counts.values()) == 6
    older = report(task="Older")
    results = [from_report(report(**told)), from_report(older)]
    sheet = causes_table(results)
    first = SimpleNamespace(**dict(zip([column.label for column in sheet.columns], sheet.rows[0].values, strict=True)))
    assert (first.grade, first.trials, first.failed) == (20.0, 6, 6)
    assert {name: vars(first)[name] for name in counts} == counts
    assert all(value is None for row in sheet.rows[1:] for value in row.values[3:])
    assert "evaluated before causes were named" in sheet.to_markdown()
