"""Lowest points of the feet in any pose, by forward kinematics of the legs without physics."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from humoslope.errors import UserError
from humoslope.scene.robot import Robot

SPACING = 0.02
"""Largest distance between the points that stand for a capsule or a box, m."""
RINGS = ((0.0, 1), (25.0, 8), (50.0, 12), (75.0, 12))
"""Points that stand for the lower half of a sphere: angle from its lowest point in degrees, and their number."""


class Soles:
    """Points on the shapes under the feet.

    Spheres and the round ends of capsules are stood for by points in the world's directions, as seen from below; a
    sphere on ground inclined by up to 35 degrees is lower than its points by at most 3 % of its radius.
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot, device: torch.device) -> None:
        """Reads the legs of `robot` off its model.

        Raises:
            UserError: If a leg has a joint that is no hinge.
        """
        root = model.body(robot.root_body).id
        legs = [_chain(model, root, model.body(body).id, robot) for body in robot.foot_bodies]
        length = max(len(leg) for leg in legs)
        still = (np.stack([np.eye(4), np.zeros((4, 4)), np.zeros((4, 4))]), 7, 0.0)
        padded = [leg + [still] * (length - len(leg)) for leg in legs]

        def tensor(values: NDArray[np.float64]) -> Tensor:
            return torch.as_tensor(values, dtype=torch.float32, device=device)

        self._links = tensor(np.array([[link[0] for link in leg] for leg in padded]))  # [2, L, 3, 4, 4]
        self._joint = torch.tensor([[link[1] for link in leg] for leg in padded], device=device)  # [2, L] in qpos
        self._zero = tensor(np.array([[link[2] for link in leg] for leg in padded]))  # [2, L] rad
        feet = [[_points(model, name) for name in geoms] for geoms in robot.foot_geoms]
        count = max(sum(len(points) for points, _ in foot) for foot in feet)
        centres, radii = np.zeros((2, count, 4)), np.zeros((2, count))
        for side, foot in enumerate(feet):
            centre = np.concatenate([points for points, _ in foot])
            radius = np.concatenate([np.full(len(points), radius) for points, radius in foot])
            # A foot with fewer points repeats its last one.
            index = np.minimum(np.arange(count), len(centre) - 1)
            centres[side], radii[side] = np.c_[centre, np.ones(len(centre))][index], radius[index]
        self._centres = tensor(centres).transpose(1, 2)  # [2, 4, C] in the foot's frame
        below = np.array([_direction(angle, k, n) for angle, n in RINGS for k in range(n)])
        self._below = tensor(radii.reshape(-1, 1, 1) * (below if radii.any() else below[:1]))  # [2 C, D, 3]

    def __call__(self, qpos: Tensor, rotation: Tensor) -> Tensor:
        """Points [N, P, 3] relative to the root, in the world's directions, m.

        Args:
            qpos: [N, nq] float32.
            rotation: [N, 3, 3] of the root, body frame to world frame.
        """
        angle = (qpos[:, self._joint] - self._zero)[..., None, None]  # [N, 2, L, 1, 1]
        one, sine, versine = self._links.unbind(dim=2)
        links = one + sine * angle.sin() + versine * (1.0 - angle.cos())  # [N, 2, L, 4, 4]
        foot = links[:, :, 0]
        for i in range(1, links.shape[2]):
            foot = foot @ links[:, :, i]
        centres = (foot @ self._centres)[:, :, :3].transpose(2, 3).flatten(1, 2)  # [N, 2 C, 3] root frame
        points = (centres @ rotation.mT).unsqueeze(2) + self._below
        return points.flatten(1, 2)


def _chain(model: mujoco.MjModel, root: int, foot: int, robot: Robot) -> list[tuple[NDArray[np.float64], int, float]]:
    """The links from below the root to the foot.

    Returns:
        For each link: [3, 4, 4], so that A + B sin(q) + C (1 - cos(q)) is its frame in that of the link before at the
        joint angle q; the place of the joint in qpos; and its reading where q is zero.
    """
    bodies = []
    while foot != root:
        bodies.append(foot)
        foot = int(model.body_parentid[foot])
    links = []
    for body in reversed(bodies):
        fixed = _frame(model.body_pos[body], model.body_quat[body])
        joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        if not joints:
            links.append((np.stack([fixed, np.zeros((4, 4)), np.zeros((4, 4))]), 7, 0.0))
        for joint in joints:
            if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
                raise UserError(f"{robot.name}: leg joint '{model.joint(joint).name}' must be a hinge.")
            x, y, z = model.jnt_axis[joint]
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # Rodrigues: R = I + K sin q + K K (1 - cos q)
            turn = np.zeros((3, 4, 4))
            turn[0] = np.eye(4)
            for part, matrix in zip(turn[1:], (cross, cross @ cross), strict=True):
                part[:3, :3], part[:3, 3] = matrix, -matrix @ model.jnt_pos[joint]
            address = int(model.jnt_qposadr[joint])
            links.append((fixed @ turn, address, float(model.qpos0[address])))
            fixed = np.eye(4)
    return links


def _points(model: mujoco.MjModel, name: str) -> tuple[NDArray[np.float64], float]:
    """Centres [C, 3] in the foot's frame and radius of the spheres that stand for a geom, m.

    A sphere and a capsule are exact; any other shape is its bounding box.
    """
    geom = model.geom(name)
    frame, kind, size = _frame(geom.pos, geom.quat), geom.type[0], geom.size
    centre, half, radius = np.zeros(3), np.zeros(3), float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        half[2] = size[1]
    elif kind != mujoco.mjtGeom.mjGEOM_SPHERE:
        centre, half, radius = model.geom_aabb[geom.id][:3], model.geom_aabb[geom.id][3:], 0.0
    axes = [np.linspace(-h, h, math.ceil(2.0 * h / SPACING) + 1) for h in half]
    local = centre + np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return local @ frame[:3, :3].T + frame[:3, 3], radius


def _frame(pos: NDArray[np.float64], quat: NDArray[np.float64]) -> NDArray[np.float64]:
    """The transformation [4, 4] of a frame at `pos`, turned by `quat` (w, x, y, z)."""
    frame, rotation = np.eye(4), np.zeros(9)
    mujoco.mju_quat2Mat(rotation, quat)
    frame[:3, :3], frame[:3, 3] = rotation.reshape(3, 3), pos
    return frame


def _direction(degrees: float, k: int, n: int) -> tuple[float, float, float]:
    """Unit vector `degrees` away from straight down, at the `k`-th of `n` bearings."""
    angle, bearing = math.radians(degrees), 2.0 * math.pi * k / n
    return math.sin(angle) * math.cos(bearing), math.sin(angle) * math.sin(bearing), -math.cos(angle)
