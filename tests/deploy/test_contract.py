"""The contract says what the robot and the task say, to the last digit, and refuses what contradicts itself."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract, GaitClock, ObservationGroup, Term
from humoslope.deploy.quantities import QUANTITIES
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
    (observation,), commands = contract.observations, contract.commands
    assert observation.history == actor.history
    given = [(term.name, term.scale, term.training_noise) for term in observation.terms]
    assert given == [(name, term.scale, term.noise) for name, term in actor.terms.items()]
    assert observation.name == "actor"
    assert contract.network.inputs == (contracts.NetworkInput("obs", "actor", (1, 480)),)
    assert contract.timing.control_step_s == cfg.sim.timestep * cfg.sim.decimation == 0.02
    assert commands.forward_m_s == cfg.command.speed
    assert commands.steering.limit_rad_s == cfg.command.yaw_rate_limit
    assert (contract.fall.root_height_below_m, contract.fall.tilt_above_deg) == (0.4, 55.0)


def test_a_contract_comes_back_from_its_text_unchanged(contract: Contract, tmp_path: Path) -> None:
    second_stage = replace(contract, training=replace(contract.training, started_from=contract.training))
    for written in (contract, second_stage):
        (tmp_path / contracts.FILE).write_text(written.to_json())
        assert contracts.read(tmp_path) == written


def test_every_observation_is_described_for_readers_without_this_code(exported: Path) -> None:
    for term in json.loads((exported / contracts.FILE).read_text())["observations"][0]["terms"]:
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
        ("version", 3, "has version 3; this program reads versions 1 to 2"),
        ("format", "mjlab", "is not the contract of a HumoSlope policy"),
        ("joints.0.default_rad", "bent", "joints[0].default_rad is 'bent'; it must be a number"),
        ("joints.0.stifness", 1.0, "field 'joints[0].stifness' does not exist; did you mean"),
        ("joints.0.name", "left_knee_joint", "two joints have the same name"),
        ("joints", [], "the network's output has shape [1, 29] for 0 joints"),
        (
            "observations.0.layout",
            "frame by frame",
            "observations[0].layout is 'frame by frame'; this version reads only",
        ),
        ("observations.0.history", 4, "have shape [1, 384] together, but input 'obs' of the network has [1, 480]"),
        ("observations.0.history", 0, "group 'actor': it must have terms, and a history of at least 1"),
        ("observations.0.terms", [], "group 'actor': it must have terms"),
        ("observations.0.name", "map", "the network takes the groups actor, but the observations are map"),
        ("observations.0.terms.0.shape", [1, 3], "has 3 components and shape [1, 3]; root_angular_velocity has 3"),
        ("observations", [], "the network takes the groups actor, but the observations are"),
        ("network.inputs", [], "the network takes the groups , but"),
        ("observations.0.terms.0.quantity", "smell", "quantity 'smell' does not exist"),
        (
            "observations.0.terms.0.components",
            ["x"],
            "term 'base_ang_vel' has 1 components and shape [3]; root_angular",
        ),
        ("timing.control_step_s", 0.018, "a whole number of physics steps"),
        ("timing.physics_step_s", 0.0, "a step must be positive"),
        ("timing.observation_age_s", 0.004, "observation_age_s 0.004 must be at least one physics step, 0.005, and at"),
        ("timing.observation_age_s", 0.21, "observation_age_s 0.21 must be at least one physics step, 0.005, and at"),
        ("action.target", "output", "action.target is 'output'"),
        ("timing.control_step_s", 1e30, "control_step_s 1e+30 must be at most 1"),
        ("joints.3.stiffness_nm_rad", -1.0, "joint 'left_knee_joint': stiffness_nm_rad -1 must be 0 or more"),
        ("joints.3.damping_nms_rad", -1.0, "joint 'left_knee_joint': damping_nms_rad -1 must be 0 or more"),
        ("joints.3.armature_kg_m2", -1.0, "joint 'left_knee_joint': armature_kg_m2 -1 must be 0 or more"),
        ("joints.3.effort_limit_nm", 0.0, "joint 'left_knee_joint': effort_limit_nm 0 must be positive"),
        ("joints.3.range_rad", [1.0, -1.0], "joint 'left_knee_joint': range_rad [1, -1] must be lowest first"),
        ("joints.3.default_rad", 10**400, "joints[3].default_rad is 1000"),
        ("robot.default_root_height_m", -1.0, "default_root_height_m -1 must be positive"),
        ("commands.forward_m_s", [1.0, 0.5], "forward_m_s [1, 0.5] must be lowest first"),
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


def test_a_contract_that_is_nested_without_end_is_refused_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / contracts.FILE).write_text("[" * 100_000)
    with pytest.raises(UserError, match="cannot be read"):
        contracts.read(tmp_path)


# Version 1: one vector, `stands`, no hash of the robot model. The file is one that was written then.

VERSION_1 = Path(__file__).parent / "data" / "policy_version_1.json"


@pytest.fixture
def version_1(tmp_path: Path) -> Callable[..., Path]:
    """version_1(change): an export folder with the contract of version 1 after `change(contract as a dict)`."""

    def make(change: Callable[[Any], object] = lambda raw: None) -> Path:
        raw = json.loads(VERSION_1.read_text())
        change(raw)
        (tmp_path / contracts.FILE).write_text(json.dumps(raw))
        return tmp_path

    return make


def test_a_contract_of_version_1_means_what_it_meant(version_1: Callable[..., Path], contract: Contract) -> None:
    old = contracts.read(version_1())
    assert old.network.inputs == (contracts.NetworkInput("obs", "actor", (1, 480)),)
    assert old.commands.trained_to_stand
    assert old.robot.sha256 is None
    # Besides hashes and the writer's version it is the same policy as is exported today.
    same = replace(
        old,
        exported_by=contract.exported_by,
        training=replace(old.training, sha256=contract.training.sha256),
        network=replace(old.network, sha256=contract.network.sha256),
        robot=replace(old.robot, sha256=contract.robot.sha256),
    )
    assert same == contract


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("network.inputs", 96, "have shape [1, 480] together, but input 'obs' of the network has [1, 96]"),
        ("network.inputs", "many", "network.inputs[0].shape[1] is 'many'"),
        ("network.outputs", 12, "the network's output has shape [1, 12] for 29 joints"),
        ("observation.terms", 3, "its fields are not those of a contract of version 1"),
        ("observation", None, "its fields are not those of a contract of version 1"),
        ("robot", [], "its fields are not those of a contract of version 1"),
        ("commands.stands", "often", "commands.trained_to_stand is 'often'; it must be true or false"),
    ],
)
def test_a_broken_contract_of_version_1_is_refused(
    version_1: Callable[..., Path], path: str, value: object, said: str
) -> None:
    with pytest.raises(UserError) as error:
        contracts.read(version_1(put(path, value)))
    assert said in str(error.value)


@pytest.mark.parametrize("name", ["network", "observation", "commands", "robot"])
def test_a_contract_of_version_1_without_a_section_is_refused(version_1: Callable[..., Path], name: str) -> None:
    with pytest.raises(UserError, match=rf"field '{name}' is missing"):
        contracts.read(version_1(lambda raw: raw.pop(name)))


# Round trips of contracts with any number of groups of any shape.

names = st.text(st.characters(codec="utf-8", exclude_categories=("Cs",)), min_size=1, max_size=8)
floats = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def contracts_of_many_groups(draw: st.DrawFn, joints: int) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Observation groups and the network inputs that take them."""
    groups = []
    for name in draw(st.lists(names, min_size=1, max_size=3, unique=True)):
        rest = tuple(draw(st.lists(st.integers(1, 9), max_size=2)))
        terms = []
        for _ in range(draw(st.integers(1, 3))):
            quantity = "custom" if rest else draw(st.sampled_from([*QUANTITIES, "custom"]))
            components = ()
            if quantity != "custom":
                components = QUANTITIES[quantity].components or tuple(f"joint {i}" for i in range(joints))
            shape = (len(components) or draw(st.integers(1, 9)), *rest)
            terms.append(
                Term(draw(names), quantity, draw(names), "", ("1",), components, shape, draw(floats), draw(floats))
            )
        group = ObservationGroup(
            name,
            draw(st.integers(1, 5)),
            "terms in this order; of each term all frames, oldest first",
            "all frames equal the first one",
            tuple(terms),
        )
        groups.append(group)
    ends = draw(st.lists(names, min_size=len(groups), max_size=len(groups), unique=True).filter(clear_of_output))
    inputs = [contracts.NetworkInput(end, g.name, group_shape(g)) for end, g in zip(ends, groups, strict=True)]
    return tuple(groups), tuple(inputs)


def clear_of_output(ends: list[str]) -> bool:
    return "actions" not in ends


def group_shape(group: ObservationGroup) -> tuple[int, ...]:
    """As NumPy concatenates the frames."""
    frames = [np.zeros(term.shape) for term in group.terms for _ in range(group.history)]
    return np.concatenate(frames)[None].shape


@given(data=st.data())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_contract_comes_back_from_its_text_unchanged(
    contract: Contract, tmp_path: Path, data: st.DataObject
) -> None:
    groups, inputs = data.draw(contracts_of_many_groups(len(contract.joints)))
    joints = tuple(replace(joint, default_rad=data.draw(floats)) for joint in contract.joints)
    clock = GaitClock(data.draw(st.floats(1e-3, 10.0)), (data.draw(floats), data.draw(floats)), data.draw(floats))
    network = replace(contract.network, inputs=inputs)
    written = replace(contract, joints=joints, observations=groups, network=network, gait_clock=clock)
    (tmp_path / contracts.FILE).write_text(written.to_json(), encoding="utf-8")
    assert contracts.read(tmp_path) == written


def test_a_phase_without_a_clock_and_a_clock_without_a_gait_are_refused(contract: Contract) -> None:
    (group,) = contract.observations
    phase = replace(group.terms[0], name="phase", quantity="gait_phase_sine", components=("left", "right"), shape=(2,))
    (end,) = contract.network.inputs
    one = replace(group, terms=(phase,), history=1)
    network = replace(contract.network, inputs=(replace(end, shape=(1, 2)),))
    seen = replace(contract, observations=(one,), network=network)
    with pytest.raises(UserError, match="term 'phase' is gait_phase_sine, but the contract has no gait_clock"):
        contracts.check(seen)
    for clock in (GaitClock(0.0, (0.0, 0.0), 0.1), GaitClock(1.0, (0.0,), 0.1)):
        with pytest.raises(UserError, match="gait_clock: its period must be positive, and there must be an offset"):
            contracts.check(replace(seen, gait_clock=clock))
    contracts.check(replace(seen, gait_clock=GaitClock(1.0, (0.0, 0.0), 0.1)))


def test_what_an_older_reader_does_not_know_is_only_written_where_it_is_used(contract: Contract) -> None:
    assert {"gait_clock", "origin"}.isdisjoint(
        json.loads(contract.to_json()) | json.loads(contract.to_json())["training"]
    )
    training = replace(contract.training, origin="elsewhere", iteration=None)
    used = replace(contract, training=training, gait_clock=GaitClock(1.0, (0.0, 3.0), 0.1))
    raw = json.loads(used.to_json())
    assert raw["gait_clock"] == {"period_s": 1.0, "offsets_rad": [0.0, 3.0], "rest_below": 0.1}
    assert (raw["training"]["origin"], raw["training"]["iteration"]) == ("elsewhere", None)


def test_two_inputs_of_one_name_are_refused(spoil: Callable[..., Path]) -> None:
    def twice(raw: Any) -> None:
        raw["network"]["inputs"] *= 2
        raw["observations"].append(raw["observations"][0] | {"name": "again"})
        raw["network"]["inputs"][1] = raw["network"]["inputs"][0] | {"group": "again"}

    with pytest.raises(UserError, match="network: two inputs or outputs have the same name"):
        contracts.read(spoil(twice))
