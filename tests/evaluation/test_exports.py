"""An export is measured as the checkpoint that it was made of, and one from outside is marked as such."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from humoslope.cli import main
from humoslope.cli.measure import subject
from humoslope.deploy import contract as contracts
from humoslope.deploy import controller
from humoslope.deploy.contract import Contract, GaitClock
from humoslope.deploy.quantities import GAIT_PHASE, QUANTITIES
from humoslope.deploy.world import World
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.evaluation.exports import FUNCTIONS, GaitPhase, env_of
from humoslope.evaluation.ramps import RampProtocol, ramp_env_cfg
from humoslope.evaluation.report.paper import read_paper
from humoslope.evaluation.report.results import read_results
from humoslope.evaluation.report.tables import main_table
from humoslope.scene.redriven import redriven
from robots.unitree_g1 import UNITREE_G1_SOLID
from tests.fake_env import FakeEnv
from tests.foreign.linear import linear, matrix
from tests.foreign.test_formats import holosoma_metadata

SHORT = ("--starts", "2", "--seconds", "0.6", "--grades", "0", "-20")
TINY = ("--grades", "30", "--tiers", "0.6", "--trials", "1", "--parallel-trials", "1", "--timeout-s", "0.4")


@pytest.fixture(scope="module")
def guest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The export of a made-up policy of holosoma's form."""
    folder = tmp_path_factory.mktemp("guest")
    (folder / "ppo.onnx").write_bytes(linear(matrix(100), holosoma_metadata(), ("actor_obs", "action")))
    assert main(["import", str(folder / "ppo.onnx"), "--out", str(folder / "ppo")]) == 0
    return folder / "ppo"


def test_an_export_walks_as_its_checkpoint(
    exported: Path, stage1_checkpoint: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reports = []
    for path in (exported, stage1_checkpoint):
        out = tmp_path / f"{path.stem}.json"
        assert main(["ramps", str(path), *SHORT, "--out", str(out)]) == 0
        assert "HumoSlope-Stage1-Unitree-G1, iteration 2969" in capsys.readouterr().out
        reports.append(json.loads(out.read_text()))
    export, checkpoint = reports
    for walked, expected in zip(export["ramps"], checkpoint["ramps"], strict=True):
        assert walked["falls"] == expected["falls"]
        for name in ("distance", "seconds"):
            assert walked[name] == pytest.approx(expected[name], abs=1e-4)
    for name in ("task", "iteration", "total_steps"):
        assert export["checkpoint"][name] == checkpoint["checkpoint"][name]
    assert export["checkpoint"]["formerly"] == [checkpoint["checkpoint"]["sha256"]]
    assert export["training_harness"] == checkpoint["training_harness"]


def test_a_row_from_outside_is_marked(guest: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", str(guest), *TINY]) == 0
    printed = capsys.readouterr().out
    assert "ppo, from outside (holosoma), trained elsewhere; " in printed
    assert "It was trained elsewhere, and nothing is known here of its training." in printed
    (result,) = read_results([f"holosoma={guest / 'heldout.json'}"])
    assert result.name == "holosoma, from outside (holosoma)"
    assert result.training[0].steps == ()
    table = main_table([result], read_paper()).to_markdown()
    assert "| holosoma, from outside (holosoma) | trained elsewhere; departs from the protocol: " in table


def test_the_environment_is_the_contracts(guest: Path) -> None:
    """Gains, pose and scales of the policy reach the simulation, and its observations have the network's width."""
    contract = contracts.read(guest)
    measured = subject(guest)
    protocol = RampProtocol(grades=(0.0,), starts=1, seconds=0.1)
    env = ManagerBasedRlEnv(ramp_env_cfg(measured.env, protocol, measured.groups))
    model, names = env.sim.model, [joint.name for joint in contract.joints]
    drives = [model.actuator(name) for name in names]
    assert [drive.gainprm[0] for drive in drives] == [joint.stiffness_nm_rad for joint in contract.joints]
    assert [-drive.biasprm[1] for drive in drives] == [joint.stiffness_nm_rad for joint in contract.joints]
    assert [-drive.biasprm[2] for drive in drives] == [joint.damping_nms_rad for joint in contract.joints]
    assert env.robot.default_joint_pos == tuple(joint.default_rad for joint in contract.joints)
    assert env.robot.action_scale == tuple(joint.action_scale_rad for joint in contract.joints)
    assert env.robot.default_root_height == contract.robot.default_root_height_m
    assert measured.load(env)(env.get_observations()).shape == (1, 29)


def test_both_clocks_of_a_gait_agree(make_env: Callable[..., FakeEnv], mask: Callable[..., Any]) -> None:
    clock = GaitClock(0.7, (0.3, 2.0), 0.05)
    env = make_env(3, commands=SimpleNamespace(velocity=None))
    ours = [GaitPhase(env, of, **vars(clock)) for of in ("sine", "cosine")]  # type: ignore[arg-type]
    theirs = [controller.GaitPhase(clock, env.step_dt) for _ in range(3)]
    rng = np.random.default_rng(0)
    for step in range(40):
        commands = rng.normal(size=(3, 3)) * (rng.random((3, 1)) < 0.8)
        env.commands.velocity = torch.tensor(commands, dtype=torch.float32)
        if step == 20:
            for term in ours:
                term.reset(mask(3, 1))
            theirs[1].reset()
        phases = np.array([of_one(command) for of_one, command in zip(theirs, commands, strict=True)])
        for term, function in zip(ours, (np.sin, np.cos), strict=True):
            np.testing.assert_allclose(term(env), function(phases), atol=1e-4)  # type: ignore[arg-type]


def test_every_quantity_can_be_observed() -> None:
    assert {name for name in QUANTITIES if not name.startswith(GAIT_PHASE)} == set(FUNCTIONS)


def test_what_cannot_be_evaluated_is_said(exported: Path) -> None:
    contract = contracts.read(exported)

    def refused(changed: Contract) -> str:
        with pytest.raises(UserError) as error:
            env_of(changed)
        return str(error.value)

    robot = replace(contract.robot, name="unitree_g2")
    assert "the export's robot 'unitree_g2' does not exist; did you mean" in refused(replace(contract, robot=robot))
    strong = replace(contract.joints[0], effort_limit_nm=500.0)
    other = replace(contract, joints=(strong, *contract.joints[1:]))
    assert "has other joints or motors than the one that is registered" in refused(other)
    (group,) = contract.observations
    custom = replace(group.terms[0], name="map", quantity="custom", meaning="Heights.")
    seen = replace(contract, observations=(replace(group, terms=(custom,)),))
    assert "observation 'map' is a custom quantity (Heights.); only the checkpoint can be evaluated" in refused(seen)


def test_a_robot_in_another_pose_still_stands_on_its_feet() -> None:
    """Straight legs are longer: thigh and shin, 0.3 m each, are no more bent by half of the knee's angle each."""
    robot = UNITREE_G1_SOLID
    legs = ("hip_pitch", "knee", "ankle_pitch")
    straight = tuple(
        0.0 if any(part in name for part in legs) else angle
        for name, angle in zip(robot.joint_names, robot.default_joint_pos, strict=True)
    )
    taller = redriven(robot, straight, robot.action_scale, robot.stiffness, robot.damping)
    assert 0.02 < taller.default_root_height - robot.default_root_height < 0.06
    assert redriven(robot, *same(robot)).default_root_height == robot.default_root_height


def same(robot: Any) -> Any:
    return robot.default_joint_pos, robot.action_scale, robot.stiffness, robot.damping


def test_plain_mujoco_knows_the_roots_velocity_in_its_own_frame(exported: Path) -> None:
    world = World(exported, contracts.read(exported), 0.0, 1.0, 10.0)
    world.reset(yaw=0.5 * np.pi)
    world.push(np.array([0.0, 2.0, 0.0]))  # ahead, where the robot looks
    world.look_now()
    measured = world.measured(np.zeros(3), np.zeros(29))
    np.testing.assert_allclose(measured.root_lin_vel_b, [2.0, 0.0, 0.0], atol=1e-9)
    term = QUANTITIES["root_linear_velocity"]
    np.testing.assert_array_equal(term.read(measured), measured.root_lin_vel_b)
    with pytest.raises(UserError, match="root_linear_velocity is not measured here"):
        term.read(replace(measured, root_lin_vel_b=None))
