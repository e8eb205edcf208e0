"""The robot of a rollout, from its URDF: shape of each link, and its pose at every step."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
import yourdfpy
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from humoslope.errors import UserError
from humoslope.replay.rollout import Rollout
from humoslope.replay.shapes import Shape

Array = NDArray[np.float64]

CREASE = math.radians(40.0)
"""Smallest angle of an edge that stays visible under smooth shading, rad."""


@dataclass(frozen=True)
class Poses:
    """Poses over T steps in the world frame: `rotation` [T, 3, 3] and `position` [T, 3], m."""

    rotation: Array
    position: Array


class RobotShape:
    """A robot as it is drawn.

    Args:
        urdf: Text of the URDF.
        meshes: Shape of each link, instead of the shapes in the URDF.

    Attributes:
        shapes: Shape of each link that has one, in the link's frame.

    Raises:
        UserError: If the URDF cannot be read, or has nothing to draw.
    """

    def __init__(self, urdf: str, meshes: Mapping[str, Shape] | None = None) -> None:
        try:
            self._urdf = yourdfpy.URDF.load(io.BytesIO(urdf.encode()), load_meshes=False)
            drawn = [link.name for link in self._urdf.robot.links if link.visuals]
            shapes = meshes if meshes is not None else {link: _shape(self._urdf, link) for link in drawn}
        except Exception as error:  # lxml, yourdfpy and trimesh have no common exception
            raise UserError(f"the robot's URDF cannot be read ({type(error).__name__}).") from None
        self.shapes = {link: shape for link, shape in shapes.items() if shape is not None}
        if not self.shapes:
            raise UserError("the robot's URDF has no box, cylinder or sphere to draw; meshes in it are not looked at.")

    def poses(self, rollout: Rollout) -> dict[str, Poses]:
        """Returns the pose of every link at every step of a walk.

        Raises:
            UserError: If a link is not connected to the root.
        """
        columns, root = rollout.columns, rollout.header["robot"]["root"]
        return self.poses_of(root, rollout.joint_names, columns.root_pos_w, columns.root_quat_w, columns.joint_pos)

    def poses_of(
        self,
        root: str,
        joint_names: Sequence[str],
        root_pos_w: NDArray[np.floating],
        root_quat_w: NDArray[np.floating],
        joint_pos: NDArray[np.floating],
    ) -> dict[str, Poses]:
        """Returns the pose of every link in T postures.

        Args:
            root: Name of the root link.
            joint_names: Names of J joints.
            root_pos_w, root_quat_w: [T, 3] m, [T, 4].
            joint_pos: [T, J] rad.

        Raises:
            UserError: If a link is not connected to the root.
        """
        angles = dict(zip(joint_names, joint_pos.T.astype(np.float64), strict=True))
        w, x, y, z = root_quat_w.T.astype(np.float64)
        rotation = Rotation.from_quat(np.stack([x, y, z, w], axis=1)).as_matrix()
        poses = {root: Poses(rotation, root_pos_w.astype(np.float64))}
        joints = list(self._urdf.robot.joints)
        while joints:  # a URDF may list a joint before its parent's
            ready = [joint for joint in joints if joint.parent in poses]
            if not ready:
                raise UserError(f"the URDF in this rollout does not connect '{joints[0].child}' to its root.")
            for joint in ready:
                poses[joint.child] = _beyond(poses[joint.parent], joint, angles.get(joint.name))
            joints = [joint for joint in joints if joint not in ready]
        return poses


def _beyond(parent: Poses, joint: Any, angle: Array | None) -> Poses:
    """Returns the poses of the link behind a joint; `angle` [T] in rad is None for a joint that does not move."""
    origin = np.eye(4) if joint.origin is None else joint.origin
    position = parent.position + parent.rotation @ origin[:3, 3]
    rotation = parent.rotation @ origin[:3, :3]
    if angle is not None:
        rotation = rotation @ Rotation.from_rotvec(angle[:, None] * joint.axis).as_matrix()
    return Poses(rotation, position)


def _shape(urdf: yourdfpy.URDF, link: str) -> Shape | None:
    """Returns the visuals of a link as one mesh; yourdfpy has put them into its scene below the link. None if there are
    none that can be drawn: files of meshes are not loaded."""
    parts, colours = [], []
    for name in urdf.scene.graph.nodes_geometry:
        if urdf.scene.graph.transforms.parents[name] != link:
            continue
        pose, geometry = urdf.scene.graph.get(name, link)
        drawn = urdf.scene.geometry[geometry]
        part = trimesh.graph.smooth_shade(drawn.to_mesh(), angle=CREASE)
        part.apply_transform(pose)
        parts.append(part)
        colours.append(np.tile(drawn.visual.main_color[:3], (len(part.vertices), 1)))
    if not parts:
        return None
    whole: Any = trimesh.util.concatenate(parts)
    return Shape(
        vertices=whole.vertices.astype(np.float32),
        normals=whole.vertex_normals.astype(np.float32),
        triangles=whole.faces.astype(np.int32),
        colours=np.concatenate(colours).astype(np.uint8),
    )
