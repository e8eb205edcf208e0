"""The drawn robot stands where the simulated one does."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
import yourdfpy
from scipy.spatial.transform import Rotation

from humoslope.errors import UserError
from humoslope.replay.robot import RobotShape
from humoslope.replay.rollout import Rollout
from robots.unitree_g1 import UNITREE_G1

COUNT = 20


@pytest.fixture(scope="module")
def posed(altered: Callable[..., Rollout]) -> Rollout:
    """Random places, turns and joint angles."""
    rng = np.random.default_rng(3)
    x, y, z, w = Rotation.random(200, rng=rng).as_quat().T
    return altered(
        root_pos_w=rng.uniform(-20.0, 20.0, (200, 3)).astype(np.float32),
        root_quat_w=np.stack([w, x, y, z], axis=1).astype(np.float32),
        joint_pos=rng.uniform(-1.5, 1.5, (200, 29)).astype(np.float32),
    )


def test_every_link_is_where_mujoco_has_it(posed: Rollout) -> None:
    model = UNITREE_G1.make_spec().compile()
    data = mujoco.MjData(model)
    poses = RobotShape(posed.header["robot"]["urdf"]).poses(posed)
    c = posed.columns
    for row in range(COUNT):
        data.qpos[:] = np.concatenate([c.root_pos_w[row], c.root_quat_w[row], c.joint_pos[row]])
        mujoco.mj_kinematics(model, data)
        for link, where in poses.items():
            np.testing.assert_allclose(where.position[row], data.body(link).xpos, atol=1e-5)
            np.testing.assert_allclose(where.rotation[row].ravel(), data.body(link).xmat, atol=1e-5)


def test_every_link_is_where_yourdfpy_has_it(posed: Rollout) -> None:
    urdf = yourdfpy.URDF.load(str(UNITREE_G1.urdf), load_meshes=False)
    poses = RobotShape(posed.header["robot"]["urdf"]).poses(posed)
    urdf.update_cfg(dict(zip(posed.joint_names, posed.columns.joint_pos[0].astype(float), strict=True)))
    root = poses["pelvis"]
    for link, where in poses.items():
        expected = urdf.get_transform(link, "pelvis")
        rotation = root.rotation[0].T @ where.rotation[0]
        position = root.rotation[0].T @ (where.position[0] - root.position[0])
        np.testing.assert_allclose(np.column_stack([rotation, position]), expected[:3], atol=1e-5)


def test_every_link_of_the_robot_is_drawn_with_unit_normals_and_its_own_colours(rollout: Rollout) -> None:
    shapes = RobotShape(rollout.header["robot"]["urdf"]).shapes
    bodies = {body.name for body in UNITREE_G1.make_spec().bodies} - {"world"}
    assert set(shapes) <= bodies
    assert len(shapes) > 25
    colours = {tuple(colour) for shape in shapes.values() for colour in shape.colours}
    assert colours == {(198, 201, 206), (43, 45, 51)}  # the two materials of the URDF
    for shape in shapes.values():
        np.testing.assert_allclose(np.linalg.norm(shape.normals, axis=1), 1.0, atol=1e-4)
        assert shape.triangles.max() < len(shape.vertices)


def test_a_urdf_that_cannot_be_read_is_said_in_one_sentence() -> None:
    with pytest.raises(UserError, match="the robot's URDF cannot be read"):
        RobotShape("hello")


def visual(shape: str) -> str:
    return f"<visual><geometry>{shape}</geometry></visual>"


def test_links_that_cannot_be_drawn_are_left_out_unless_all_are() -> None:
    box, mesh = visual("<box size='1 1 1'/>"), visual("<mesh filename='trunk.stl'/>")
    shapes = RobotShape(f"<robot name='r'><link name='a'>{box}</link><link name='b'>{mesh}</link></robot>").shapes
    assert list(shapes) == ["a"]
    with pytest.raises(UserError, match="has no box, cylinder or sphere to draw"):
        RobotShape(f"<robot name='r'><link name='b'>{mesh}</link></robot>")


def test_a_link_without_a_way_to_the_root_is_named(rollout: Rollout) -> None:
    joint = "<joint name='j' type='fixed'><parent link='a'/><child link='b'/></joint>"
    box = visual("<box size='1 1 1'/>")
    urdf = f"<robot name='r'><link name='a'>{box}</link><link name='b'/>{joint}</robot>"
    with pytest.raises(UserError, match="does not connect 'b'"):
        RobotShape(urdf).poses(rollout)
