"""The contract says what the robot and the task say, to the last digit, and refuses what contradicts itself."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.errors import UserError
from humoslope.registry import build_task
from robots.unitree_g1 import UNITREE_G1


def test_the_robots_numbers_arrive_at_full_precision(contract: Contract) -> None:
    robot, joints = UNITREE_G1, contract.joints
    assert tuple(joint.name for joint in joints) == robot.joint_names
    assert tuple(joint.default_rad for joint in joints) == robot.default_joint_pos
    assert tuple(joint.action_scale_rad for joint in joints) == robot.action_scale
    assert tuple(joint.stiffness_nm_rad for joint in joints) == robot.stiffness
    assert tuple(joint.damping_nms_rad for joint in joints) == robot.damping
    assert tuple(joint.effort_limit_nm for joint in joints) == robot.effort_limit
    model = robot.make_spec().compile()
    for joint in joints:
        assert joint.range_rad == tuple(model.joint(joint.name).range)
        assert joint.armature_kg_m2 == model.dof_armature[model.joint(joint.name).dofadr[0]]


def test_the_tasks_numbers_arrive(contract: Contract) -> None:
    cfg = build_task("HumoSlope-Stage1-Unitree-G1").env
    actor = cfg.observations.actor
    observation, commands = contract.observation, contract.commands
    assert observation.history == actor.history
    given = [(term.name, term.scale, term.training_noise) for term in observation.terms]
    assert given == [(name, term.scale, term.noise) for name, term in actor.terms.items()]
    assert contract.network.inputs == 480
    assert contract.timing.control_step_s == cfg.sim.timestep * cfg.sim.decimation == 0.02
    assert commands.forward_m_s == cfg.command.speed
    assert commands.steering.limit_rad_s == cfg.command.yaw_rate_limit
    assert (contract.fall.root_height_below_m, contract.fall.tilt_above_deg) == (0.4, 55.0)


def test_a_contract_comes_back_from_its_text_unchanged(contract: Contract, tmp_path: Path) -> None:
    second_stage = replace(contract, training=replace(contract.training, started_from=contract.training))
    for written in (contract, second_stage):
        (tmp_path / contracts.FILE).write_text(written.to_json())
        assert contracts.read(tmp_path) == written


def test_every_observation_is_described_for_who_has_not_this_code(exported: Path) -> None:
    for term in json.loads((exported / contracts.FILE).read_text())["observation"]["terms"]:
        assert len(term["meaning"]) > 20
        assert len(term["unit"]) in (1, len(term["components"]))
        assert len(term["components"]) in (3, UNITREE_G1.num_joints)


def test_what_is_no_contract_is_said(tmp_path: Path, exported: Path) -> None:
    with pytest.raises(UserError, match=r"export folder '.*nowhere' does not exist; `humoslope export CHECKPOINT`"):
        contracts.read(tmp_path / "nowhere")
    with pytest.raises(UserError, match="holds no policy.json"):
        contracts.read(tmp_path)
    file = tmp_path / contracts.FILE
    shutil.copy(exported / contracts.FILE, file)
    file.write_bytes(file.read_bytes()[:500])
    with pytest.raises(UserError, match="cannot be read: "):
        contracts.read(tmp_path)
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UserError, match="cannot be read: "):
        contracts.read(tmp_path)
    file.write_text('["policy"]')
    with pytest.raises(UserError, match="is not the contract of a HumoSlope policy"):
        contracts.read(tmp_path)


def put(path: str, value: object) -> Callable[[Any], None]:
    """Sets a value in a nested dict, such as put("timing.control_step_s", 0.0)."""

    def change(raw: Any) -> None:
        *parents, last = path.split(".")
        for name in parents:
            raw = raw[int(name) if name.isdigit() else name]
        raw[last] = value

    return change


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("version", 2, "has version 2; this program reads version 1"),
        ("format", "mjlab", "is not the contract of a HumoSlope policy"),
        ("joints.0.default_rad", "bent", "joints[0].default_rad is 'bent'; it must be a number"),
        ("joints.0.stifness", 1.0, "field 'joints[0].stifness' does not exist; did you mean"),
        ("joints.0.name", "left_knee_joint", "joints: two have the same name"),
        ("joints", [], "the network has 29 outputs for 0 joints"),
        ("observation.layout", "frame by frame", "observation.layout is 'frame by frame'; this version reads only"),
        ("observation.history", 4, "its terms make 384 numbers, but the network has 480 inputs"),
        ("observation.terms.0.quantity", "smell", "quantity 'smell' does not exist"),
        ("observation.terms.0.components", ["x"], "term 'base_ang_vel' has 1 components; root_angular_velocity has 3"),
        ("timing.control_step_s", 0.018, "a whole number of physics steps"),
        ("timing.physics_step_s", 0.0, "a step must be positive"),
        ("timing.observation_age_s", 0.02, "observation_age_s is another"),
        ("action.target", "output", "action.target is 'output'"),
    ],
)
def test_a_contract_that_cannot_be_kept_is_refused(
    spoil: Callable[..., Path], path: str, value: object, said: str
) -> None:
    folder = spoil(put(path, value))
    with pytest.raises(UserError) as error:
        contracts.read(folder)
    assert said in str(error.value)
    assert str(folder) in str(error.value)
