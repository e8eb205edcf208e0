"""deploy.yaml, read as Unitree's deployment reads it, puts together the observation of the contract."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.deploy.controller import Observer
from humoslope.deploy.quantities import Measured
from humoslope.deploy.unitree import deploy_yaml
from humoslope.errors import UserError


@pytest.fixture(scope="module")
def contract(exported: Path) -> Contract:
    return contracts.read(exported)


@pytest.fixture(scope="module")
def deploy(exported: Path) -> dict[str, Any]:
    text = (exported / "params" / "deploy.yaml").read_text()
    assert "&" not in text  # no anchors
    read: dict[str, Any] = yaml.safe_load(text)
    return read


TERMS: dict[str, Callable[[Measured, Any], Any]] = {
    "base_ang_vel": lambda m, cfg: m.root_ang_vel_b,
    "projected_gravity": lambda m, cfg: -m.up_b,
    "velocity_commands": lambda m, cfg: m.command,
    "joint_pos_rel": lambda m, cfg: m.joint_pos_rel,
    "joint_vel_rel": lambda m, cfg: m.joint_vel,
    "last_action": lambda m, cfg: m.last_action,
}
"""The observations that its C++ registers under these names, in its own words."""


def test_its_observation_is_that_of_the_contract(deploy: dict[str, Any], contract: Contract) -> None:
    rng = np.random.default_rng(0)

    def instant() -> Measured:
        quaternion = rng.normal(size=4)
        return Measured(
            quaternion / np.linalg.norm(quaternion),
            rng.normal(size=3),
            rng.normal(size=29),
            rng.normal(size=29),
            rng.uniform(-1.0, 1.0, 3),
            rng.normal(size=29),
        )

    instants = [instant() for _ in range(7)]
    theirs = []
    for name, term in deploy["observations"].items():
        assert term["clip"] is None
        frames = [np.array(term["scale"]) * TERMS[name](m, deploy) for m in instants]
        theirs += frames[-term["history_length"] :]
    observe = Observer(contract.observations[0])
    for m in instants:
        ours = observe(m)
    np.testing.assert_allclose(np.concatenate(theirs), ours, rtol=1e-6)


def test_its_targets_and_gains_are_those_of_the_contract(deploy: dict[str, Any], contract: Contract) -> None:
    action, joints = deploy["actions"]["JointPositionAction"], contract.joints
    assert action["joint_names"] == [joint.name for joint in joints]
    assert action["scale"] == [joint.action_scale_rad for joint in joints]
    assert action["offset"] == deploy["default_joint_pos"] == [joint.default_rad for joint in joints]
    assert action["clip"] is action["joint_ids"] is None
    assert deploy["joint_ids_map"] == list(range(29))
    assert deploy["stiffness"] == [joint.stiffness_nm_rad for joint in joints]
    assert deploy["damping"] == [joint.damping_nms_rad for joint in joints]
    assert deploy["step_dt"] == 0.02


def test_a_released_stick_is_a_command_to_stand(deploy: dict[str, Any]) -> None:
    ranges = deploy["commands"]["base_velocity"]["ranges"]
    assert ranges == {"lin_vel_x": [0.0, 0.8], "lin_vel_y": [0.0, 0.0], "ang_vel_z": [-0.3, 0.3], "heading": None}


def test_an_observation_that_it_does_not_know_is_refused(contract: Contract) -> None:
    (group,) = contract.observations
    strange = replace(group, terms=(replace(group.terms[0], quantity="custom"),))
    with pytest.raises(UserError, match="observation 'base_ang_vel': Unitree's deployment has none for custom"):
        deploy_yaml(replace(contract, observations=(strange,)))


def test_a_network_that_it_cannot_feed_is_refused(contract: Contract) -> None:
    (group,), (end,) = contract.observations, contract.network.inputs
    two = replace(contract, observations=(group, replace(group, name="map")))
    with pytest.raises(UserError, match="feeds one input, but the policy reads the groups actor, map"):
        deploy_yaml(two)
    renamed = replace(contract, network=replace(contract.network, inputs=(replace(end, name="actor"),)))
    with pytest.raises(UserError, match="feeds an input called 'obs', but the network's is 'actor'"):
        deploy_yaml(renamed)
