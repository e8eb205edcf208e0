"""The G1 whose parts cannot pass through each other."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humoslope.packing import describe
from humoslope.scene.sensors import add_contact_sensors
from humoslope.terrain.mjcf import TERRAIN_GEOM
from robots.unitree_g1 import UNITREE_G1, UNITREE_G1_SOLID
from tests.robots.test_unitree_g1 import BODIES

TODAY = "db3776ed8de101473689c7dec3d5d3789fa8558e8aff2b5aa4f30c081c18b705"
"""Hash of the model of the shipped checkpoints."""
LEG = ("hip_roll_link", "hip_yaw_link", "knee_link", "ankle_roll_link")
ARM = ("shoulder_yaw_link", "elbow_link", "wrist_pitch_link", "wrist_yaw_link")
NEIGHBOURS = {
    frozenset(("pelvis", "torso_link")),
    *(frozenset(("pelvis", f"{side}_hip_roll_link")) for side in ("left", "right")),
    *(
        frozenset((f"{side}_{upper}", f"{side}_{lower}"))
        for side in ("left", "right")
        for limb in (LEG, ARM)
        for upper, lower in itertools.pairwise(limb)
    ),
}


@pytest.fixture(scope="module")
def solid() -> mujoco.MjModel:
    return UNITREE_G1_SOLID.make_spec().compile()


def pairs_that_meet(model: mujoco.MjModel) -> Iterator[tuple[int, int]]:
    """Collision geoms on different bodies that are not neighbours."""
    named = [i for i in range(model.ngeom) if model.geom(i).name]
    for first, second in itertools.combinations(named, 2):
        bodies = frozenset(model.body(model.geom_bodyid[i]).name for i in (first, second))
        if len(bodies) == 2 and bodies not in NEIGHBOURS:
            yield first, second


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_parts_touch_where_their_shapes_overlap_and_nowhere_else(solid: mujoco.MjModel, seed: int) -> None:
    model, data = solid, mujoco.MjData(solid)
    data.qpos[7:] = np.random.default_rng(seed).uniform(*model.jnt_range[1:].T)
    mujoco.mj_forward(model, data)
    touching = {frozenset(pair) for pair in data.contact.geom.tolist()}
    overlapping = {
        frozenset(pair)
        for pair in pairs_that_meet(model)
        if mujoco.mj_geomDistance(model, data, *pair, 0.1, None) < 0.0
    }
    assert touching == overlapping


def test_upper_arms_forearms_and_hands_meet_trunk_pelvis_and_thighs(solid: mujoco.MjModel) -> None:
    meeting = {frozenset(solid.body(solid.geom_bodyid[i]).name for i in pair) for pair in pairs_that_meet(solid)}
    for side, other in itertools.product(("left", "right"), repeat=2):
        for part, target in itertools.product(ARM, ("torso_link", "pelvis", f"{other}_hip_yaw_link")):
            assert frozenset((f"{side}_{part}", target)) in meeting


def test_the_default_pose_touches_nothing_and_no_shapes_are_near(solid: mujoco.MjModel) -> None:
    data = mujoco.MjData(solid)
    mujoco.mj_resetDataKeyframe(solid, data, solid.key("knees_bent").id)
    mujoco.mj_forward(solid, data)
    assert data.ncon == 0
    assert min(mujoco.mj_geomDistance(solid, data, *pair, 0.1, None) for pair in pairs_that_meet(solid)) > 0.03


def test_it_has_the_joints_masses_and_numbers_of_the_robot(solid: mujoco.MjModel) -> None:
    same = UNITREE_G1.make_spec().compile()
    for name in ("body_mass", "body_inertia", "body_ipos", "jnt_range", "dof_armature", "actuator_gainprm", "key_qpos"):
        np.testing.assert_array_equal(getattr(solid, name), getattr(same, name))
    ours, theirs = describe(UNITREE_G1_SOLID), describe(UNITREE_G1)
    assert {name for name in ours if ours[name] != theirs[name]} == {"name", "model"}


@pytest.mark.parametrize(
    ("body", "published", "ours"),
    [
        ("hip_roll_link", "hip_collision", "hip_collision"),
        ("shoulder_yaw_link", "shoulder_yaw_collision", "upper_arm_collision"),
        ("wrist_pitch_link", "wrist_collision", "wrist_collision"),
    ],
)
@pytest.mark.parametrize("side", ["left", "right"])
def test_shapes_that_the_urdf_lacks_are_the_published_ones(
    solid: mujoco.MjModel, side: str, body: str, published: str, ours: str
) -> None:
    shapes = {shape["name"]: shape for shape in BODIES[f"{side}_{body}"]["collision_primitives"]}
    shape, geom = shapes[f"{side}_{published}"], solid.geom(f"{side}_{ours}")
    ends = np.array(shape["fromto"]).reshape(2, 3)
    assert geom.size[0] == shape["radius"]
    assert geom.size[1] == pytest.approx(0.5 * np.linalg.norm(ends[1] - ends[0]))
    np.testing.assert_allclose(geom.pos, ends.mean(axis=0), atol=1e-12)
    assert solid.body(geom.bodyid[0]).name == f"{side}_{body}"


def test_the_ground_meets_the_same_shapes_as_those_of_the_robot() -> None:
    def met(robot) -> set[str]:
        spec = robot.make_spec()
        spec.worldbody.add_geom(name=TERRAIN_GEOM, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
        model = spec.compile()
        data = mujoco.MjData(model)
        data.qpos[:] = model.key_qpos[0]
        data.qpos[2] = -3.0
        mujoco.mj_forward(model, data)
        return {model.geom(i).name for pair in data.contact.geom.tolist() for i in pair}

    assert met(UNITREE_G1_SOLID) == met(UNITREE_G1)


def test_the_model_of_the_shipped_checkpoints_is_unchanged() -> None:
    assert hashlib.sha256(UNITREE_G1.make_spec().to_xml().encode()).hexdigest() == TODAY


def test_the_sensor_has_the_strongest_contact_of_the_robot_with_itself_and_none_with_the_ground() -> None:
    spec = UNITREE_G1_SOLID.make_spec()
    spec.worldbody.add_geom(name=TERRAIN_GEOM, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    add_contact_sensors(spec, UNITREE_G1_SOLID)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = model.key_qpos[0]
    data.qpos[2] -= 0.005
    mujoco.mj_forward(model, data)
    assert data.ncon > 0
    assert np.linalg.norm(data.sensor("self_force").data) == 0.0

    for side, inward in (("left", -1.0), ("right", 1.0)):
        data.joint(f"{side}_shoulder_roll_joint").qpos = 0.3 * inward
    mujoco.mj_forward(model, data)
    forces, wrench = [], np.zeros(6)
    for i, contact in enumerate(data.contact):
        if all(model.geom_bodyid[geom] for geom in contact.geom):
            mujoco.mj_contactForce(model, data, i, wrench)
            forces.append(np.linalg.norm(wrench[:3]))
    assert len(forces) > 1
    assert np.linalg.norm(data.sensor("self_force").data) == pytest.approx(max(forces))
    assert max(forces) > 1.0
