"""The robot and its ground are what the contract and the course say."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from humoslope.deploy.contract import Contract
from humoslope.deploy.player import Player
from humoslope.deploy.world import RUN_UP, World
from humoslope.errors import UserError


@pytest.mark.parametrize("grade", [0.0, 25.0, -25.0])
def test_the_ground_lies_where_it_is_said_to(make_player: Callable[..., Player], grade: float) -> None:
    world = make_player(grade=grade).world
    hit = np.zeros(1, dtype=np.int32)
    for x in (-2.0, 0.0, RUN_UP - 0.01, RUN_UP + 0.01, 1.0, 4.0, 10.0):
        start = np.array([x, 2.0, 20.0])  # beside the robot
        depth = mujoco.mj_ray(world.model, world.data, start, np.array([0.0, 0.0, -1.0]), None, 1, -1, hit)
        expected = math.tan(math.radians(grade)) * max(x - RUN_UP, 0.0)
        assert 20.0 - depth == pytest.approx(expected, abs=1e-6)
        assert world.ground(x) == pytest.approx(expected)
    assert world.along(RUN_UP + 1.0) - world.along(RUN_UP) == pytest.approx(1.0 / math.cos(math.radians(grade)))


def test_feet_have_the_friction_of_the_course(make_player: Callable[..., Player]) -> None:
    player = make_player(grade=30.0)
    assert player.cfg.friction == pytest.approx(math.tan(math.radians(30.0)) + 0.3)
    for name in player.contract.robot.foot_geoms:
        assert player.world.model.geom(name).friction[0] == player.cfg.friction


def test_drives_give_the_contracts_torque(make_player: Callable[..., Player], contract: Contract) -> None:
    """Also where the effort limit cuts it off: the targets are a radian away."""
    world = make_player().world
    joints = contract.joints
    kp, kd, limit = (
        np.array([getattr(joint, name) for joint in joints])
        for name in ("stiffness_nm_rad", "damping_nms_rad", "effort_limit_nm")
    )
    rng = np.random.default_rng(0)
    reached = 0
    for _ in range(20):
        position = world.data.qpos[7:].copy()
        target = position + rng.uniform(-2.0, 2.0, len(joints))
        velocity = world.data.qvel[6:].copy()
        world.data.ctrl[:] = target
        mujoco.mj_step(world.model, world.data)
        torque = np.clip(kp * (target - position) - kd * velocity, -limit, limit)
        np.testing.assert_allclose(world.data.actuator_force, torque, atol=1e-9)
        reached += int((np.abs(torque) == limit).sum())
    assert reached > 0


def test_what_is_measured_is_a_physics_step_older_than_the_state(make_player: Callable[..., Player]) -> None:
    player = make_player()
    player.start()
    world, seen = player.world, []
    target = np.array([joint.default_rad for joint in player.contract.joints]) + 0.1
    copy = mujoco.MjData(world.model)
    mujoco.mj_copyData(copy, world.model, world.data)
    world.step(target)
    copy.ctrl[:] = target
    for _ in range(player.contract.decimation):
        seen.append((copy.qpos.copy(), copy.qvel.copy()))
        mujoco.mj_step(world.model, copy)
    measured = world.measured(np.zeros(3), np.zeros(29))
    qpos, qvel = seen[-1]
    np.testing.assert_array_equal(measured.joint_vel, qvel[6:])
    np.testing.assert_array_equal(measured.root_quat_w, qpos[3:7])
    np.testing.assert_array_equal(measured.root_ang_vel_b, qvel[3:6])
    np.testing.assert_array_equal(world.root_pos, qpos[:3])
    np.testing.assert_array_equal(world.data.qpos, copy.qpos)


def test_a_control_step_of_one_physics_step_is_measured_before_it(exported: Path, contract: Contract) -> None:
    timing = replace(contract.timing, control_step_s=0.005)
    world = World(exported, replace(contract, timing=timing), 0.0, 0.8, 20.0)
    before = world.data.qvel[6:].copy()
    world.step(np.zeros(29))
    np.testing.assert_array_equal(world.measured(np.zeros(3), np.zeros(29)).joint_vel, before)
    assert world.data.time == 0.005


def test_a_gyroscope_in_the_root_would_measure_the_same(make_player: Callable[..., Player]) -> None:
    world = make_player().world
    world.data.qpos[3:7] = np.array([0.8, 0.2, -0.4, 0.4])
    world.data.qvel[:6] = [1.0, 2.0, 3.0, 0.5, -0.7, 0.9]
    mujoco.mj_forward(world.model, world.data)
    world._take_state()
    velocity = np.zeros(6)
    root = world.model.body("pelvis").id
    mujoco.mj_objectVelocity(world.model, world.data, mujoco.mjtObj.mjOBJ_XBODY, root, velocity, 1)
    np.testing.assert_allclose(world.measured(np.zeros(3), np.zeros(29)).root_ang_vel_b, velocity[:3], atol=1e-12)


def put(world: World, height: float, pitch: float) -> World:
    """The robot with its root at a height, leaning forward, degrees."""
    half = 0.5 * math.radians(pitch)
    world.data.qpos[2:7] = [height, math.cos(half), 0.0, math.sin(half), 0.0]
    world._take_state()
    return world


def test_a_fall_is_what_the_contract_calls_one(make_player: Callable[..., Player], contract: Contract) -> None:
    world = make_player().world
    assert not put(world, 0.75, 0.0).fallen()
    assert not put(world, 0.41, 54.0).fallen()
    assert put(world, 0.39, 0.0).fallen()
    assert put(world, 0.75, 56.0).fallen()
    indifferent = replace(contract, fall=replace(contract.fall, root_height_below_m=None, tilt_above_deg=None))
    assert not put(make_player(indifferent).world, 0.1, 90.0).fallen()


def test_a_robot_whose_physics_went_wrong_has_fallen(make_player: Callable[..., Player]) -> None:
    world = make_player().world
    world.step(np.full(29, np.nan))
    assert world.fallen()
    world.reset()
    assert not world.fallen()


def test_starts_are_within_the_joints_ranges(make_player: Callable[..., Player], contract: Contract) -> None:
    world = make_player().world
    world.reset(x=0.1, y=-0.2, yaw=0.3, joints=10.0)
    np.testing.assert_allclose(world.data.qpos[7:], [joint.range_rad[1] for joint in contract.joints])
    np.testing.assert_allclose(world.root_pos[:2], [0.1, -0.2])
    assert world.yaw == pytest.approx(0.3)


def test_a_model_that_does_not_fit_the_contract_is_said(spoil: Callable[..., Path], contract: Contract) -> None:
    contract = replace(contract, robot=replace(contract.robot, sha256=None))  # as in version 1: any model
    folder = spoil()
    model = folder / contract.robot.file
    text = model.read_text()

    def said() -> str:
        with pytest.raises(UserError) as error:
            World(folder, contract, 0.0, 0.8, 20.0)
        assert "\n" not in str(error.value)
        return str(error.value)

    model.write_text(text.replace("left_knee_joint", "left_kneee_joint"))
    assert "joint 'left_knee_joint' does not exist; did you mean 'left_kneee_joint'?" in said()
    model.write_text(text.replace('name="pelvis"', 'name="hips"'))
    assert "body 'pelvis' does not exist" in said()
    model.write_text(text.replace("left_foot1_collision", "left_toe"))
    assert "geom 'left_foot1_collision' does not exist" in said()
    model.write_text(text.replace('<joint name="floating_base" type="free"/>', ""))
    assert "body 'pelvis' has no free joint" in said()
    model.write_text(text.replace('name="floating_base"', ""))  # it needs no name
    World(folder, contract, 0.0, 0.8, 20.0)
    model.write_text(text[:1000])
    assert "model.xml' is no MuJoCo model: " in said()
    model.write_text(text)
    weak = replace(contract, joints=tuple(replace(joint, effort_limit_nm=-1.0) for joint in contract.joints))
    with pytest.raises(UserError, match=r"the robot model does not go with the contract: .*invalid force range"):
        World(folder, weak, 0.0, 0.8, 20.0)
    model.unlink()
    assert "model.xml' does not exist; it is part of the export" in said()


def test_a_model_other_than_the_contracts_is_refused(spoil: Callable[..., Path], contract: Contract) -> None:
    folder = spoil()
    model = folder / contract.robot.file
    model.write_text(model.read_text().replace("</mujoco>", "</mujoco> "))
    with pytest.raises(UserError, match=r"model.xml' is not the robot model that the contract beside it"):
        World(folder, contract, 0.0, 0.8, 20.0)


def test_a_foot_is_down_while_the_ground_carries_it(make_player: Callable[..., Player]) -> None:
    world = make_player().world
    assert [world.model.body(body).name for body in world.foot_bodies] == [
        "left_ankle_roll_link",
        "right_ankle_roll_link",
    ]
    assert list(world.feet_down()) == [False, False]  # it starts a centimetre above the ground
    default = world._default.copy()
    for _ in range(25):
        world.step(default)
    assert list(world.feet_down()) == [True, True]
    data, model = world.data, world.model
    for side, lifted in (("left", [False, True]), ("right", [True, False])):
        data.qpos[model.joint(f"{side}_knee_joint").qposadr[0]] += 0.8
        mujoco.mj_forward(model, data)
        assert list(world.feet_down()) == lifted
        data.qpos[model.joint(f"{side}_knee_joint").qposadr[0]] -= 0.8
    data.qpos[2] += 1.0
    mujoco.mj_forward(model, data)
    assert list(world.feet_down()) == [False, False]
