"""Scripted walks along a track, whose every figure is known beforehand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import torch
from torch import Tensor

from humoslope.evaluation.track.arrays import map_arrays
from humoslope.evaluation.track.recorder import LegJoints, StepSample, TrackRecorder, TrackTrials
from robots.unitree_g1 import UNITREE_G1

DT = 0.02
LEGS = LegJoints(UNITREE_G1, torch.device("cpu"))
TRACK = 10.0  # m
SEGMENTS = (2.0, 5.0, 8.0)  # m, where the second, third and fourth segment begin


def index(name: str) -> int:
    return UNITREE_G1.joint_names.index(name)


def sample(worlds: int, place: float | Tensor = 0.0, **values: float | Tensor) -> StepSample:
    """A sample of `worlds` worlds that all show these values; joints by name, such as left_knee_joint_torque."""
    place = torch.as_tensor(place, dtype=torch.float32).expand(worlds).contiguous()
    joints = {kind: torch.zeros(worlds, UNITREE_G1.num_joints) for kind in ("pos", "vel", "torque")}
    scalars = ("speed", "yaw_rate", "com_height", "root_height", "torso_pitch", "self_force")
    plain = dict.fromkeys(scalars, torch.zeros(worlds))
    for name, value in values.items():
        spread = torch.as_tensor(value, dtype=torch.float32).expand(worlds)
        if name in plain:
            plain[name] = spread
        else:
            joint, _, kind = name.rpartition("_")
            joints[kind][:, index(joint)] = spread
    return StepSample(
        place=place,
        segment=torch.bucketize(place, torch.tensor(SEGMENTS), right=True),
        commanded=torch.full((worlds,), 0.5),
        **plain,
        joint_pos=joints["pos"],
        joint_vel=joints["vel"],
        joint_torque=joints["torque"],
        legs=LEGS,
    )


def recorder(trials: int, dt: float = DT, **changes: object) -> TrackRecorder:
    settings = {"robot": UNITREE_G1, "length": TRACK, "device": torch.device("cpu")}
    return TrackRecorder(trials, len(SEGMENTS) + 1, dt, **settings | changes)


def walk(steps: int, show: Callable[[int], dict[str, object]], worlds: int = 1, speed: float = 0.5) -> TrackTrials:
    """Every world walks its own trial at `speed` and shows what `show` tells of each step."""
    track = recorder(worlds)
    everyone, numbers = torch.ones(worlds, dtype=torch.bool), torch.arange(worlds)
    for step in range(steps):
        track.add(numbers, sample(worlds, 0.5 + speed * DT * step, speed=speed, **show(step)), everyone)
    return track.trials()


def outcomes(trials: TrackTrials, **arrays: object) -> SimpleNamespace:
    """Finished trials with these outcomes, such as success=[True, False]; by default all in one condition."""
    nobody, zero = np.zeros(len(trials), dtype=bool), np.zeros(len(trials))
    default = {"success": nobody, "fell": nobody, "left": nobody, "timed_out": nobody}
    default |= {"seconds": zero, "max_place": zero}
    default |= {"grade_index": zero.astype(np.int64), "tier_index": zero.astype(np.int64)}
    given = {name: np.array(value) for name, value in arrays.items()}
    return SimpleNamespace(metrics=trials, **default | given)


def as_if(trials: TrackTrials, **arrays: object) -> TrackTrials:
    """The trials with some of their arrays or recorded values replaced."""
    given = {name: np.array(value) for name, value in arrays.items()}
    values = {name: given.pop(name, value) for name, value in trials.values.items()}
    return replace(trials, values=values, **given)


def join(parts: Sequence[TrackTrials]) -> TrackTrials:
    """All trials of the parts, in their order."""
    return map_arrays(lambda *arrays: np.concatenate(arrays), *parts)
