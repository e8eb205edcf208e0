"""Where the parts of a robot are, and what its feet carry, from what its sensors read."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from humoslope.deploy.contract import Contract
from humoslope.deploy.quantities import Array
from humoslope.errors import UserError


class Kinematics:
    """The robot of an export without ground, posed by what its sensors read.

    Args:
        folder: The export folder.
        contract: The contract in it.
    """

    def __init__(self, folder: Path, contract: Contract) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(folder / contract.robot.file))
        self.data = mujoco.MjData(self.model)
        names = [joint.name for joint in contract.joints]
        self._qpos = np.array([self.model.joint(name).qposadr[0] for name in names])
        self._dofs = np.array([self.model.joint(name).dofadr[0] for name in names])
        root = self.model.body(contract.robot.root_body)
        self._root, self._free = int(root.id), int(self.model.joint(root.jntadr[0]).qposadr[0])
        bodies: dict[int, list[int]] = {}
        for name in contract.robot.foot_geoms:
            geom = self.model.geom(name)
            bodies.setdefault(int(geom.bodyid[0]), []).append(int(geom.id))
        if len(bodies) != 2:
            raise UserError(f"the robot has {len(bodies)} feet; a walk is put together for two.")
        self.feet = list(bodies)
        self._soles = list(bodies.values())
        below = np.array([0.0, 0.0, 1.0])
        self.corners = [
            np.array([self.model.geom_pos[g] - self.model.geom_size[g][0] * below for g in geoms])
            for geoms in self._soles
        ]

    def pose(self, quat_w: Array, joint_pos: Array) -> None:
        """Poses the robot with its root at the origin."""
        self.data.qpos[:] = 0.0
        self.data.qpos[self._free + 3 : self._free + 7] = quat_w
        self.data.qpos[self._qpos] = joint_pos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)

    def soles(self) -> Array:
        """Returns the lowest point of each foot, in its middle, relative to the root in world axes, [2, 3] m."""
        data, model, result = self.data, self.model, np.zeros((2, 3))
        for foot, geoms in enumerate(self._soles):
            result[foot] = np.mean([data.geom_xpos[geom] for geom in geoms], axis=0)
            # Spheres and capsules reach below their centres by their radius.
            result[foot, 2] = min(data.geom_xpos[g][2] - model.geom_size[g][0] for g in geoms)
        return result

    def feet_poses(self) -> tuple[Array, Array]:
        """Returns positions [2, 3] m and rotation matrices [2, 3, 3] of the feet, the root being the origin."""
        return self.data.xpos[self.feet].copy(), self.data.xmat[self.feet].reshape(2, 3, 3).copy()

    def wrenches(self, torque: Array) -> Array:
        """Returns force, N, and torque about the foot's origin, Nm, of the ground on each foot in world axes, [2, 6],
        that the torques [J] of its leg balance if the leg has no weight and no inertia."""
        jacobian, result = np.zeros((6, self.model.nv)), np.zeros((2, 6))
        tau = np.zeros(self.model.nv)
        tau[self._dofs] = torque
        for foot, body in enumerate(self.feet):
            mujoco.mj_jacBody(self.model, self.data, jacobian[:3], jacobian[3:], body)
            leg = [dof for dof in self._dofs if jacobian[:, dof].any()]
            result[foot] = np.linalg.lstsq(jacobian[:, leg].T, -tau[leg], rcond=1e-3)[0]
        return result

    def pressed(self, wrench: Array, rotation: Array, foot: int) -> Array:
        """Returns the centre of pressure in the foot's frame, [3] m, within the corners of its sole.

        Args:
            wrench: [6] force and torque of the ground in world axes.
            rotation: [3, 3] of the foot.
            foot: Index of the foot.
        """
        force, torque = rotation.T @ wrench[:3], rotation.T @ wrench[3:]
        corners = self.corners[foot]
        low, high = corners.min(axis=0), corners.max(axis=0)
        depth = low[2]
        up = max(force[2], 1.0)
        # The torque about the foot's origin of a force at (x, y, depth).
        at = np.array([(force[0] * depth - torque[1]) / up, (torque[0] + force[1] * depth) / up, depth])
        return np.clip(at, low, high)

    def turning(self, joint_vel: Array) -> Array:
        """Returns the angular velocity of the root in its own axes that keeps each foot from turning, [2, 3] rad/s.

        Args:
            joint_vel: [J] joint velocities, rad/s.
        """
        turn, velocity, result = np.zeros((3, self.model.nv)), np.zeros(self.model.nv), np.zeros((2, 3))
        velocity[self._dofs] = joint_vel
        root = self.data.xmat[self._root].reshape(3, 3)
        for foot, body in enumerate(self.feet):
            mujoco.mj_jacBody(self.model, self.data, None, turn, body)
            result[foot] = root.T @ -(turn @ velocity)  # the root itself does not move in `velocity`
        return result

    def com(self) -> Array:
        """Returns the centre of mass relative to the root in world axes, [3] m."""
        return self.data.subtree_com[self._root].copy()
