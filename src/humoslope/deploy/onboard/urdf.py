"""A robot model of MuJoCo as a URDF that viewers draw: links, turning joints, and plain shapes."""

from __future__ import annotations

from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import mujoco
import numpy as np

from humoslope.deploy.quantities import Array
from humoslope.errors import UserError

GEOM, JOINT = mujoco.mjtGeom, mujoco.mjtJoint
REACH = 3.15
"""Range of a joint without one, rad."""


def urdf(model: mujoco.MjModel, root: str, name: str) -> str:
    """Returns the bodies below `root` as a URDF with what MuJoCo would draw: capsules, cylinders, spheres and boxes.

    Raises:
        UserError: If a body has more than one joint, which a URDF's link cannot have.
    """
    robot = Element("robot", name=name)
    first = model.body(root).id
    below = [body for body in range(model.nbody) if body == first or _is_below(model, body, first)]
    for body in below:
        link = SubElement(robot, "link", name=model.body(body).name)
        for geom in _drawn(model, body):
            _visual(link, model, geom)
    for body in below:
        if body != first:
            _joint(robot, model, body)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode")


def _is_below(model: mujoco.MjModel, body: int, root: int) -> bool:
    while body > root:
        body = int(model.body_parentid[body])
    return body == root


def _drawn(model: mujoco.MjModel, body: int) -> list[int]:
    """Geoms that only are seen, if there are any, else all."""
    geoms = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom] == body]
    seen = [geom for geom in geoms if not model.geom_contype[geom] and not model.geom_conaffinity[geom]]
    return seen or geoms


def _visual(link: Element, model: mujoco.MjModel, geom: int) -> None:
    kind, (a, b, c) = model.geom_type[geom], model.geom_size[geom]
    pos, quat = model.geom_pos[geom], model.geom_quat[geom]
    shapes: list[tuple[str, dict[str, str], Array]] = []
    if kind == GEOM.mjGEOM_SPHERE:
        shapes = [("sphere", {"radius": f"{a:.6g}"}, pos)]
    elif kind == GEOM.mjGEOM_BOX:
        shapes = [("box", {"size": _text(2.0 * np.array([a, b, c]))}, pos)]
    elif kind in (GEOM.mjGEOM_CYLINDER, GEOM.mjGEOM_CAPSULE):
        shapes = [("cylinder", {"radius": f"{a:.6g}", "length": f"{2.0 * b:.6g}"}, pos)]
        if kind == GEOM.mjGEOM_CAPSULE:
            axis = np.zeros(3)
            mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, b]), quat)
            shapes += [("sphere", {"radius": f"{a:.6g}"}, pos + end * axis) for end in (-1.0, 1.0)]
    for shape, size, at in shapes:
        visual = SubElement(link, "visual")
        SubElement(visual, "origin", xyz=_text(at), rpy=_rpy(quat))
        SubElement(SubElement(visual, "geometry"), shape, size)
        material = SubElement(visual, "material", name=f"{link.get('name')}_{geom}")
        SubElement(material, "color", rgba=_text(model.geom_rgba[geom]))


def _joint(robot: Element, model: mujoco.MjModel, body: int) -> None:
    count, first = model.body_jntnum[body], model.body_jntadr[body]
    name = model.body(body).name
    if count > 1 or (count and model.jnt_type[first] != JOINT.mjJNT_HINGE):
        raise UserError(f"body '{name}' of the robot model has joints that a URDF cannot have.")
    kind = "revolute" if count else "fixed"
    joint = SubElement(robot, "joint", name=model.joint(first).name if count else f"{name}_fixed", type=kind)
    SubElement(joint, "parent", link=model.body(model.body_parentid[body]).name)
    SubElement(joint, "child", link=name)
    SubElement(joint, "origin", xyz=_text(model.body_pos[body]), rpy=_rpy(model.body_quat[body]))
    if not count:
        return
    if np.abs(model.jnt_pos[first]).max() > 1e-9:
        raise UserError(f"joint '{model.joint(first).name}' does not turn about the origin of its body.")
    SubElement(joint, "axis", xyz=_text(model.jnt_axis[first]))
    low, high = model.jnt_range[first] if model.jnt_limited[first] else (-REACH, REACH)
    SubElement(joint, "limit", lower=f"{low:.6g}", upper=f"{high:.6g}", effort="0", velocity="0")


def _text(values: Array) -> str:
    return " ".join(f"{value:.6g}" for value in values)


def _rpy(quat: Array) -> str:
    """Roll, pitch and yaw of a quaternion, w first, as a URDF has them: about fixed axes, roll first."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    m = matrix.reshape(3, 3)
    pitch = np.arcsin(np.clip(-m[2, 0], -1.0, 1.0))
    if abs(m[2, 0]) > 1.0 - 1e-9:  # roll and yaw turn about the same axis
        return _text(np.array([0.0, pitch, np.arctan2(-m[0, 1], m[1, 1])]))
    return _text(np.array([np.arctan2(m[2, 1], m[2, 2]), pitch, np.arctan2(m[1, 0], m[0, 0])]))
