"""The exported Stage I: its contract, a player of it, and copies of its folder to spoil."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.deploy.player import Player, TrialCfg
from humoslope.deploy.quantities import Measured
from humoslope.seal import SUMS


@pytest.fixture(scope="session")
def contract(exported: Path) -> Contract:
    return contracts.read(exported)


@pytest.fixture(scope="session")
def make_player(exported: Path, contract: Contract) -> Callable[..., Player]:
    """make_player(grade=20.0, contract=other): a player of the export on this course, by this contract."""

    def make(contract: Contract = contract, **cfg: Any) -> Player:
        return Player(exported, contract, TrialCfg(**cfg))

    return make


@pytest.fixture
def spoil(exported: Path, tmp_path: Path) -> Callable[..., Path]:
    """spoil(change): a copy of the export after `change(contract as a dict)`; `network` replaces the network's bytes,
    and its hash in the contract."""

    def make(change: Callable[[Any], object] = lambda raw: None, network: bytes | None = None) -> Path:
        folder = Path(shutil.copytree(exported, tmp_path / "spoilt"))
        (folder / SUMS).unlink()  # the change is meant
        raw = json.loads((folder / contracts.FILE).read_text())
        if network is not None:
            (folder / raw["network"]["file"]).write_bytes(network)
            raw["network"]["sha256"] = hashlib.sha256(network).hexdigest()
        change(raw)
        (folder / contracts.FILE).write_text(json.dumps(raw))
        return folder

    return make


@pytest.fixture(scope="session")
def measured() -> Measured:
    """A robot of three joints that stands upright and still."""
    return Measured(
        root_quat_w=np.array([1.0, 0.0, 0.0, 0.0]),
        root_ang_vel_b=np.zeros(3),
        joint_pos_rel=np.zeros(3),
        joint_vel=np.zeros(3),
        command=np.zeros(3),
        last_action=np.zeros(3),
    )


@pytest.fixture(scope="session")
def with_terms(contract: Contract) -> Callable[..., Contract]:
    """with_terms(joint_velocity={"scale": 1.0}): the contract with fields of these quantities' terms changed."""

    def make(**changes: dict[str, Any]) -> Contract:
        (group,) = contract.observations
        terms = tuple(replace(term, **changes.get(term.quantity, {})) for term in group.terms)
        return replace(contract, observations=(replace(group, terms=terms),))

    return make
