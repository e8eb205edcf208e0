"""Each condition against a closed form or plain MuJoCo, and none where there are none."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humoslope.deploy.conditions import Conditions
from humoslope.deploy.contract import Contract
from humoslope.deploy.player import Player, TrialCfg
from humoslope.deploy.world import World
from humoslope.errors import UserError


@pytest.fixture(scope="module")
def make_world(exported: Path, contract: Contract) -> Callable[..., World]:
    """make_world(cross=20.0, load_kg=3.0): the robot of the export under these conditions."""

    def make(cross: float = 0.0, model: Path | None = None, **conditions: Any) -> World:
        return World(exported, contract, 0.0, 0.8, 20.0, cross, Conditions(**conditions), model)

    return make


def seen(world: World) -> Any:
    return world.measured(np.zeros(3), np.zeros(29))


def test_the_default_conditions_change_no_bit_of_a_walk(exported: Path, contract: Contract) -> None:
    """Against the loop as the contract states it, in plain MuJoCo calls."""
    player = Player(exported, contract, TrialCfg(seconds=2.0))
    player.start(np.random.default_rng(3))
    world, copy = player.world, mujoco.MjData(player.world.model)
    mujoco.mj_copyData(copy, world.model, world.data)
    for _ in range(50):
        player.step(player.course_command())
        copy.ctrl[:] = world._default + player.controller._scale * player.controller.last_action
        mujoco.mj_step(world.model, copy, contract.decimation - 1)
        np.testing.assert_array_equal(seen(world).joint_pos_rel, copy.qpos[7:] - world._default)
        np.testing.assert_array_equal(seen(world).root_ang_vel_b, copy.qvel[3:6])
        np.testing.assert_array_equal(seen(world).root_quat_w, copy.qpos[3:7])
        mujoco.mj_step(world.model, copy)
        np.testing.assert_array_equal(world.data.qpos, copy.qpos)
        np.testing.assert_array_equal(world.data.qvel, copy.qvel)


@given(steps=st.integers(0, 11))
def test_a_delayed_target_takes_effect_exactly_so_many_physics_steps_late(
    make_world: Callable[..., World], steps: int
) -> None:
    world = make_world(delay_s=steps * 0.005)
    copy = mujoco.MjData(world.model)
    mujoco.mj_copyData(copy, world.model, world.data)
    targets = [world._default + 0.1 * (k + 1) for k in range(5)]
    physics_step = 0
    for target in targets:
        world.step(target)
        for _ in range(4):
            late = physics_step - steps
            copy.ctrl[:] = targets[late // 4] if late >= 0 else world._default
            mujoco.mj_step(world.model, copy)
            physics_step += 1
        np.testing.assert_array_equal(world.data.qpos, copy.qpos)


def test_a_reset_forgets_targets_under_way(make_world: Callable[..., World]) -> None:
    world = make_world(delay_s=0.1)
    world.step(np.full(29, 2.0))
    world.reset()
    for _ in range(6):
        world.step(world._default)
    np.testing.assert_array_equal(world.data.ctrl, world._default)


def test_a_load_is_a_point_mass_at_the_centre_of_the_torso(make_world: Callable[..., World]) -> None:
    plain, loaded = make_world().model, make_world(load_kg=7.0).model
    torso, pelvis = (plain.body(name).id for name in ("torso_link", "pelvis"))
    added = loaded.body_mass - plain.body_mass
    assert added[torso] == pytest.approx(7.0)
    assert added.sum() == pytest.approx(7.0)
    assert loaded.body_subtreemass[pelvis] - plain.body_subtreemass[pelvis] == pytest.approx(7.0)
    np.testing.assert_array_equal(loaded.body_inertia, plain.body_inertia)
    np.testing.assert_array_equal(loaded.body_ipos, plain.body_ipos)
    with pytest.raises(UserError, match="body 'torso' does not exist; did you mean 'torso_link'"):
        make_world(load_kg=1.0, load_body="torso")


def torques(world: World) -> Any:
    world.data.ctrl[:] = world._default
    rng = np.random.default_rng(0)
    world.data.qpos[7:] += rng.uniform(-1.0, 1.0, 29)
    world.data.qvel[6:] = rng.uniform(-1.0, 1.0, 29)
    mujoco.mj_forward(world.model, world.data)
    return world.data.actuator_force.copy()


def test_strength_scales_every_torque_and_its_limit(make_world: Callable[..., World]) -> None:
    full, weak = torques(make_world()), torques(make_world(strength=0.6))
    np.testing.assert_allclose(weak, 0.6 * full, rtol=1e-12)


def test_policy_and_motors_read_the_same_wrong_encoders(make_world: Callable[..., World], contract: Contract) -> None:
    bias = np.random.default_rng(1).uniform(-0.1, 0.1, 29)
    world = make_world(encoder_bias_rad=tuple(bias), timestep_s=0.02)
    np.testing.assert_allclose(seen(world).joint_pos_rel, world.data.qpos[7:] - world._default + bias, atol=1e-15)
    position, velocity, target = world.data.qpos[7:].copy(), world.data.qvel[6:].copy(), world._default + 0.2
    world.step(target)
    kp, kd, limit = (
        np.array([getattr(joint, name) for joint in contract.joints])
        for name in ("stiffness_nm_rad", "damping_nms_rad", "effort_limit_nm")
    )
    torque = np.clip(kp * (target - (position + bias)) - kd * velocity, -limit, limit)
    np.testing.assert_allclose(world.data.actuator_force, torque, atol=1e-9)
    with pytest.raises(UserError, match="encoder_bias_rad has 2 entries for 29 joints"):
        make_world(encoder_bias_rad=(0.1, 0.1))


def test_a_tilted_imu_reads_gravity_and_rotation_in_its_own_frame(make_world: Callable[..., World]) -> None:
    angle = math.radians(10.0)
    pitched, rolled = make_world(imu_tilt_rad=(0.0, angle)), make_world(imu_tilt_rad=(angle, 0.0))
    # An upright robot's IMU that leans forward (about +y) sees up towards its -x; one that leans right, towards +y.
    np.testing.assert_allclose(seen(pitched).up_b, [-math.sin(angle), 0.0, math.cos(angle)], atol=1e-12)
    np.testing.assert_allclose(seen(rolled).up_b, [0.0, math.sin(angle), math.cos(angle)], atol=1e-12)
    for world in (pitched, rolled):
        world.data.qpos[3:7] = np.array([0.8, 0.2, -0.4, 0.4])
        world.data.qvel[3:6] = [0.5, -0.7, 0.9]
        world._take_state()
        turn = {True: (0.0, angle), False: (angle, 0.0)}[world is pitched]
        half = np.array([math.cos(angle / 2), *(math.sin(angle / 2) * np.array([*turn, 0.0]) / angle)])
        mount, root = np.zeros(9), np.zeros(9)
        mujoco.mju_quat2Mat(mount, half)
        mujoco.mju_quat2Mat(root, world.data.qpos[3:7])
        mount, root = mount.reshape(3, 3), root.reshape(3, 3)
        np.testing.assert_allclose(seen(world).root_ang_vel_b, mount.T @ [0.5, -0.7, 0.9], atol=1e-12)
        np.testing.assert_allclose(seen(world).up_b, (root @ mount)[2], atol=1e-12)
    assert pitched.yaw == rolled.yaw  # the course is not read from the IMU


def test_a_push_changes_the_momentum_of_the_whole_robot(make_world: Callable[..., World]) -> None:
    world = make_world()
    world.push(np.array([0.6, -0.8, 0.0]))
    mujoco.mj_forward(world.model, world.data)
    mujoco.mj_subtreeVel(world.model, world.data)
    np.testing.assert_allclose(world.data.subtree_linvel[world.model.body("pelvis").id], [0.6, -0.8, 0.0], atol=1e-12)


def test_pushes_come_at_their_times(exported: Path, contract: Contract, monkeypatch: pytest.MonkeyPatch) -> None:
    cfg, conditions = TrialCfg(seconds=1.0), Conditions(push_m_s=0.3, push_every_s=0.4)
    player = Player(exported, contract, cfg, conditions)
    pushes: list[tuple[float, float]] = []
    monkeypatch.setattr(
        player.world, "push", lambda v: pushes.append((player.world.data.time, float(np.linalg.norm(v))))
    )
    player.run_trial(np.random.default_rng(0))
    np.testing.assert_allclose(pushes, [(0.4, 0.3), (0.8, 0.3)])


@pytest.mark.parametrize("steps", [40, 20, 10, 8, 5, 3, 2, 1])
def test_the_age_of_what_is_seen_does_not_depend_on_the_physics_step(
    make_world: Callable[..., World], steps: int
) -> None:
    """A robot that falls freely and spins at a constant rate shows when it was seen: 5 ms before the next targets."""
    world = make_world(timestep_s=0.02 / steps)
    world.model.opt.gravity[:] = 0.0
    world.data.qpos[2] += 10.0
    world.data.qvel[:3] = [1.0, 0.0, 0.0]
    mujoco.mj_forward(world.model, world.data)
    start = world.data.qpos[0]
    world.step(world._default)
    assert world.data.time == pytest.approx(0.02)
    assert world.root_pos[0] - start == pytest.approx(0.015, abs=2e-5)
    with pytest.raises(UserError, match="no whole number of physics steps of 0.003 s"):
        make_world(timestep_s=0.003)


@pytest.mark.parametrize("steps", [20, 10, 7, 4, 2, 1])
@settings(max_examples=8)
@given(age=st.floats(0.005, 0.2))
def test_measurements_are_as_old_as_the_contract_says(
    exported: Path, contract: Contract, steps: int, age: float
) -> None:
    """Of a joint that moves at a constant speed, and a root that turns at one; at first they show the start."""
    timing = replace(contract.timing, observation_age_s=age)
    world = World(
        exported, replace(contract, timing=timing), 0.0, 0.8, 20.0, conditions=Conditions(timestep_s=0.02 / steps)
    )
    world.model.opt.gravity[:] = 0.0
    world.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    world.data.qpos[2] += 10.0
    world.data.qvel[5] = 1.0
    mujoco.mj_forward(world.model, world.data)
    world._take_state()
    yaws = [world.yaw]
    for step in range(1, 13):
        world.step(world._default)
        yaws.append(world.yaw)
        w, _, _, z = seen(world).root_quat_w
        np.testing.assert_allclose(2.0 * math.atan2(z, w), max(0.02 * step - age, 0.0), atol=1e-3)
    np.testing.assert_allclose(yaws[1:], 0.02 * np.arange(1, 13) - 0.005, atol=1e-3)  # the course is not measured


@pytest.mark.parametrize("cross", [20.0, -20.0])
def test_across_a_slope_the_ground_rises_to_one_side_and_a_foot_begins_just_above_it(
    make_world: Callable[..., World], cross: float
) -> None:
    world, hit = make_world(cross=cross), np.zeros(1, dtype=np.int32)
    for x, y in ((0.0, 2.0), (3.0, -2.0)):
        depth = mujoco.mj_ray(world.model, world.data, [x, y, 20.0], [0.0, 0.0, -1.0], None, 1, -1, hit)
        assert 20.0 - depth == pytest.approx(math.tan(math.radians(cross)) * y, abs=1e-6)
        assert world.ground(x, y) == pytest.approx(math.tan(math.radians(cross)) * y)
    assert world._clearance() == pytest.approx(0.01)
    assert world.data.ncon == 0
    assert not world.fallen()
    with pytest.raises(UserError, match="cannot be combined"):
        TrialCfg(grade=5.0, cross=5.0)


@pytest.mark.parametrize("grade", [20.0, -20.0])
def test_without_a_run_up_the_robot_begins_on_the_slope(exported: Path, contract: Contract, grade: float) -> None:
    world, hit = World(exported, contract, grade, 0.8, 20.0, run_up=False), np.zeros(1, dtype=np.int32)
    for x, y in ((0.0, 2.0), (3.0, -2.0), (-3.0, 0.0)):
        depth = mujoco.mj_ray(world.model, world.data, [x, y, 20.0], [0.0, 0.0, -1.0], None, 1, -1, hit)
        assert 20.0 - depth == pytest.approx(math.tan(math.radians(grade)) * x, abs=1e-6)
        assert world.ground(x, y) == pytest.approx(math.tan(math.radians(grade)) * x)
        assert world.along(x) == pytest.approx(x / math.cos(math.radians(grade)))
    assert world._clearance() == pytest.approx(0.01)
    assert world.data.ncon == 0


def test_a_robot_touches_itself_where_two_of_its_parts_press_on_each_other(exported: Path, contract: Contract) -> None:
    """With parts that may collide, which they may not in the export; an elbow is moved into the trunk."""
    world = World(exported, contract, 0.0, 0.8, 20.0)
    for _ in range(25):
        world.step(world._default)
    assert world.data.ncon > 0  # it stands
    assert not world.touches_itself()
    for kind in (world.model.geom_contype, world.model.geom_conaffinity):
        kind[:] = 1
    for kind in (world.model.body_contype, world.model.body_conaffinity):
        kind[:] = 1
    world.data.joint("left_shoulder_roll_joint").qpos[:] = -1.0
    mujoco.mj_forward(world.model, world.data)
    assert world.touches_itself()


def test_another_model_walks_with_the_motors_and_the_physics_of_the_export(
    exported: Path, contract: Contract, tmp_path: Path
) -> None:
    text = (exported / contract.robot.file).read_text()
    for name in contract.robot.foot_geoms:
        assert name in text
        text = text.replace(f'name="{name}"', "")
    path = tmp_path / "other.xml"
    path.write_text(text.replace("</worldbody>", '<geom type="plane" size="1 1 1" pos="0 0 5"/></worldbody>'))
    player = Player(exported, contract, TrialCfg(seconds=3.0), model=path)
    own = Player(exported, contract, TrialCfg(seconds=3.0))
    assert player.world.model.ngeom == own.world.model.ngeom  # its ground is gone
    assert player.world.model.opt.cone == own.world.model.opt.cone
    trials = [p.run_trial(np.random.default_rng(0)) for p in (player, own)]
    assert [trial.fell for trial in trials] == [False, False]
    assert trials[0].distance == pytest.approx(trials[1].distance, abs=0.2)

    path.write_text(text.replace('name="left_knee_joint"', 'name="left_nee_joint"'))
    with pytest.raises(UserError, match="lacks 'left_knee_joint' and adds 'left_nee_joint'"):
        Player(exported, contract, TrialCfg(), model=path)
    path.write_text("<mujoco>")
    with pytest.raises(UserError, match="is no MuJoCo model"):
        Player(exported, contract, TrialCfg(), model=path)


def test_to_a_side_and_backward_it_holds_its_heading_and_straight_ahead_its_course(
    exported: Path, contract: Contract
) -> None:
    gain = contract.commands.steering.heading_gain_per_s
    for course in ({"speed": 0.0, "lateral": -0.3}, {"speed": -0.3}, {"speed": 0.5}):
        player = Player(exported, contract, TrialCfg(grade=10.0, **course))
        player.world.reset(y=0.1, yaw=0.05)
        forward, left, yaw_rate = player.course_command()
        assert (forward, left) == (course["speed"], course.get("lateral", 0.0))
        if course["speed"] > 0.0:
            assert yaw_rate < -gain * 0.05  # it is also led back to the middle
            assert player.world.ground(-1.0) == 0.0
        else:
            assert yaw_rate == pytest.approx(-gain * 0.05)
            assert player.world.ground(-1.0) < 0.0


def test_a_turning_robot_reports_its_yaw_rate_and_its_speed_along_its_heading(
    exported: Path, contract: Contract, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A robot carried round a circle of 1 m at 0.5 rad/s, for more than one half-turn."""
    player = Player(exported, contract, TrialCfg(seconds=10.0, yaw_rate=0.5))
    world, turned = player.world, 0.0

    def carry(command: Any) -> None:
        nonlocal turned
        np.testing.assert_array_equal(command, [0.5, 0.0, 0.5])
        turned += 0.5 * 0.02
        world._seen_pos[:2] = [math.sin(turned), 1.0 - math.cos(turned)]
        world._seen_pos[3:7] = [math.cos(turned / 2), 0.0, 0.0, math.sin(turned / 2)]

    monkeypatch.setattr(player, "start", lambda rng: None)
    monkeypatch.setattr(player, "step", carry)
    trial = player.run_trial(np.random.default_rng(0))
    assert trial.yaw_rate == pytest.approx(0.5)
    assert trial.heading_speed == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize(
    "wrong",
    [
        {"load_kg": -1.0},
        {"strength": 0.0},
        {"delay_s": -0.1},
        {"delay_s": 1e300},
        {"timestep_s": 0.0},
        {"timestep_s": 1e-9},
        {"push_m_s": math.nan},
        {"encoder_bias_rad": (0.0, math.inf)},
    ],
)
def test_impossible_conditions_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(UserError, match=next(iter(wrong))):
        replace(Conditions(), **wrong)
