"""A recorded session is a rollout that shows where the robot went, and what it said."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from humoslope.cli import main
from humoslope.deploy.contract import Contract
from humoslope.deploy.onboard.kinematics import Kinematics
from humoslope.deploy.onboard.log import _seen_ahead, to_rollout
from humoslope.deploy.onboard.session import Ticks
from humoslope.deploy.onboard.states import Mode
from humoslope.errors import UserError
from humoslope.replay.robot import RobotShape
from humoslope.replay.rollout import Rollout, load_rollout
from tests.deploy.onboard.conftest import SCRIPT, Stage
from tests.replay.rerun.test_rrd import column, read


@pytest.fixture(scope="module")
def walk(stage: Callable[..., Stage]) -> Stage:
    """From the gantry up a ramp of 15 degrees, for six seconds."""
    return stage(SCRIPT, grade=15.0, hold_heading=True).run(11.0)


@pytest.fixture(scope="module")
def saved(walk: Stage, exported: Path, contract: Contract, tmp_path_factory: pytest.TempPathFactory) -> Path:
    rollout, more = to_rollout(exported, contract, walk.session.ticks, "test")
    path = tmp_path_factory.mktemp("log") / "walk.npz"
    rollout.save(path, **more)
    return path


@pytest.fixture(scope="module")
def rollout(saved: Path) -> Rollout:
    return load_rollout(saved)


def test_the_way_is_found_from_the_feet(walk: Stage, rollout: Rollout) -> None:
    """Against the true way, which the log does not know: within 5 % of the length, and 3 degrees of the grade."""
    columns, x = rollout.columns, walk.robot.world.root_pos[0]
    walked = columns.root_pos_w[-1, 0] - columns.root_pos_w[0, 0]
    assert walked == pytest.approx(x, rel=0.05)
    late = columns.root_pos_w[-100:]
    rise = np.degrees(np.arctan2(late[-1, 2] - late[0, 2], late[-1, 0] - late[0, 0]))
    assert rise == pytest.approx(15.0, abs=3.0)
    standing = columns.root_height[(columns.time > 5.5)]
    assert 0.65 < standing.min() < standing.max() < 0.85


def test_feet_carry_the_weight_that_the_torques_balance(walk: Stage, rollout: Rollout) -> None:
    on_the_ground = rollout.columns.time > 6.0
    carried = rollout.columns.foot_force_w[on_the_ground, :, 2].sum(axis=1)
    model = walk.robot.world.model
    # All but the leg that stands, which is taken to have no weight.
    mass = walk.robot.mass - float(model.body_subtreemass[model.body("left_hip_pitch_link").id])
    assert carried.mean() == pytest.approx(9.81 * mass, rel=0.1)


def test_a_row_holds_what_was_measured_after_its_action(walk: Stage, saved: Path, rollout: Rollout) -> None:
    ticks, columns = walk.session.ticks, rollout.columns
    row = next(k for k, mode in enumerate(ticks.mode) if mode is Mode.WALK) + 20
    np.testing.assert_allclose(columns.action[row], ticks.action[row], rtol=1e-6)
    np.testing.assert_allclose(columns.command[row], ticks.command[row], rtol=1e-6)
    np.testing.assert_allclose(columns.joint_pos[row], ticks.reading[row + 1].joint_pos, rtol=1e-5, atol=1e-6)
    robot = rollout.header["robot"]
    target = np.array(robot["default_joint_pos"]) + np.array(robot["action_scale"]) * columns.action
    with np.load(saved) as archive:
        assert archive["mode"][row] == "WALK"
        held = archive["stiffness"].any(axis=1)
        np.testing.assert_allclose(archive["target"][held], target[held], atol=1e-5)
    assert [event.text for event in rollout.events] == ["zero torque", "move", "hold", "walk"]


def test_velocity_slope_and_bank_are_those_in_the_direction_of_the_heading() -> None:
    """A robot that faces 30 degrees to the left of the way up, and one that faces across it, with the way up on its
    right: it walks ahead at 0.5 m/s and to the right at 0.2 m/s, on ground that rises by 0.4 m per metre of x."""
    yaw, rise = np.radians([30.0, 90.0]), np.full(2, 0.4)
    ahead, right = np.stack([np.cos(yaw), np.sin(yaw)]), np.stack([np.sin(yaw), -np.cos(yaw)])
    x, y = 0.5 * ahead + 0.2 * right
    along, slope, bank = _seen_ahead(yaw, rise, np.stack([x, y, 0.5 * rise * np.cos(yaw)], axis=1))
    np.testing.assert_allclose(np.tan(slope), [0.4 * math.sqrt(0.75), 0.0], atol=1e-12)
    np.testing.assert_allclose(np.tan(bank), [-0.2, -0.4])  # the left lies lower
    np.testing.assert_allclose(along[:, 0], 0.5 / np.cos(slope))
    np.testing.assert_allclose(along[:, 1], -0.2)
    np.testing.assert_allclose(along[:, 2], 0.0, atol=1e-12)


def test_viewers_pose_the_robot_as_mujoco_does(rollout: Rollout, exported: Path, contract: Contract) -> None:
    shape = RobotShape(rollout.header["robot"]["urdf"])
    poses = shape.poses(rollout)
    kinematics, row = Kinematics(exported, contract), 300
    kinematics.pose(rollout.columns.root_quat_w[row], rollout.columns.joint_pos[row])
    model, data = kinematics.model, kinematics.data
    for link in ("pelvis", "left_ankle_roll_link", "right_wrist_yaw_link", "torso_link"):
        body = model.body(link).id
        place = data.xpos[body] + rollout.columns.root_pos_w[row]
        np.testing.assert_allclose(poses[link].position[row], place, atol=1e-4)
        np.testing.assert_allclose(poses[link].rotation[row].ravel(), data.xmat[body], atol=1e-4)
    drawn = {link.get("name") for link in ElementTree.fromstring(rollout.header["robot"]["urdf"]).iter("link")}
    assert set(shape.shapes) <= drawn
    assert len(shape.shapes) > 15


def test_a_standing_leg_turns_the_root_as_its_joints_do(exported: Path, contract: Contract) -> None:
    """Against finite differences of the pose of the root relative to a foot."""
    kinematics, rng = Kinematics(exported, contract), np.random.default_rng(0)
    pos, vel, step = 0.3 * rng.normal(size=29), rng.normal(size=29), 1e-6

    def rotations(q: np.ndarray) -> np.ndarray:
        kinematics.pose(np.array([1.0, 0.0, 0.0, 0.0]), q)
        return kinematics.feet_poses()[1].copy()

    before, after = rotations(pos), rotations(pos + step * vel)
    kinematics.pose(np.array([1.0, 0.0, 0.0, 0.0]), pos)
    for foot, turning in enumerate(kinematics.turning(vel)):
        relative = before[foot] @ after[foot].T  # of the root, seen from the foot that stands
        spin = np.array([relative[2, 1], relative[0, 2], relative[1, 0]]) / step
        np.testing.assert_allclose(turning, spin, atol=1e-4)


def test_loads_balance_a_robot_that_stands(exported: Path, contract: Contract) -> None:
    """The torques of a foot that is pushed by a known force, by MuJoCo's Jacobian, give the force back."""
    kinematics = Kinematics(exported, contract)
    kinematics.pose(np.array([1.0, 0.0, 0.0, 0.0]), np.array([joint.default_rad for joint in contract.joints]))
    model, data, wrench = kinematics.model, kinematics.data, np.array([10.0, -5.0, 150.0, 1.0, -2.0, 0.5])
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], kinematics.feet[0])
    torque = -(jacobian.T @ wrench)[[model.joint(joint.name).dofadr[0] for joint in contract.joints]]
    found = kinematics.wrenches(torque)
    np.testing.assert_allclose(found[0], wrench, atol=1e-6)
    np.testing.assert_allclose(found[1], 0.0, atol=1e-6)


def test_a_session_without_commands_is_no_walk(exported: Path, contract: Contract) -> None:
    with pytest.raises(UserError, match="the robot was never commanded"):
        to_rollout(exported, contract, Ticks(), "test")


def test_replay_shows_the_walk_of_a_log(saved: Path, rollout: Rollout, tmp_path: Path) -> None:
    """As typed; the recording for rerun has the robot at every tick, although there are no rewards to plot."""
    path = tmp_path / "walk.rrd"
    assert main(["replay", str(saved), "--save", str(path)]) == 0
    shown = read(path)
    steps, places = column(shown["/world/robot/torso_link"], "translation")
    np.testing.assert_array_equal(steps, np.arange(1, len(rollout.columns) + 1))
    poses = RobotShape(rollout.header["robot"]["urdf"]).poses(rollout)
    np.testing.assert_allclose(np.array(places).reshape(-1, 3), poses["torso_link"].position, atol=1e-5)
    assert {"/world/ground", "/world/contact/left", "/world/robot/left_ankle_roll_link"} <= set(shown)
