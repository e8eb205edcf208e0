"""A walk of the real robot, recorded once, and walks made by hand from it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from humoslope.env import ManagerBasedRlEnv
from humoslope.learning.policy import Provenance
from humoslope.registry import build_task
from humoslope.replay.record import RecordProtocol, record, record_env_cfg, with_provenance
from humoslope.replay.rollout import Rollout

PROTOCOL = RecordProtocol(terrain="ramp-up", grade=20.0, seconds=4.0, push=1.5, push_every=0.9)


@pytest.fixture(scope="session")
def walk() -> Callable[..., Rollout]:
    """walk("HumoSlope-Stage1-Unitree-G1", protocol): the rollout of a robot that only holds its pose."""

    def make(task: str, protocol: RecordProtocol) -> Rollout:
        cfg = record_env_cfg(build_task(task).env, protocol)
        cfg.sim.backend = "native"
        env = ManagerBasedRlEnv(cfg)
        rollout = record(env, lambda obs: torch.zeros(1, env.robot.num_joints), protocol)
        provenance = Provenance(Path("model_7.pt"), "ab" * 32, task, 7, 1000, 0.0)
        return with_provenance(rollout, provenance, label="statue")

    return make


@pytest.fixture(scope="session")
def rollout(walk: Callable[..., Rollout]) -> Rollout:
    """Four seconds of a robot that is pushed at a ramp of 20 degrees until it falls."""
    return walk("HumoSlope-Stage1-Unitree-G1", PROTOCOL)


@pytest.fixture(scope="session")
def altered(rollout: Rollout) -> Callable[..., Rollout]:
    """altered(zmp_valid=...): the recorded walk with other columns."""

    def make(**columns: object) -> Rollout:
        return dataclasses.replace(rollout, columns=dataclasses.replace(rollout.columns, **columns))

    return make
