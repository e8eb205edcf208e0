"""Named, batched signals of the robot on its terrain, all of one instant."""

from __future__ import annotations

import torch
from torch import Tensor

from humoslope.scene.robot import Robot
from humoslope.scene.sensors import SIDES
from humoslope.sim.protocol import Simulation
from humoslope.slope import quaternion
from humoslope.terrain.queries import TerrainQueries

CONTACT_FORCE = 1.0
"""A foot is in contact above this force, N (as in Unitree RL Lab and Isaac Lab)."""


class Signals:
    """What terms read of the world. `refresh` takes everything anew;
    the tensors of the last refresh are never written again.

    Frames: `_w` world, `_b` root body, `_t` along the ground:
    forward in the heading direction, left, and out of the slope.

    Attributes:
        joint_pos, joint_vel, joint_torque: [N, J] rad, rad/s, Nm.
        root_pos_w, root_quat_w, root_lin_vel_w, root_ang_vel_b: [N, 3 or 4].
        root_lin_vel_b, root_lin_vel_t: [N, 3] m/s.
        projected_gravity_b: [N, 3] unit vector of gravity in the root frame.
        heading_w: [N] yaw, rad.
        root_height: [N] root above the ground below it, m.
        slope_normal_w: [N, 3] of the ground below the root, at the scale of a step.
        slope_pitch: [N] inclination of the ground in the heading direction, rad, positive uphill.
        torso_quat_w, torso_ang_vel_w: [N, 4], [N, 3] rad/s.
        com_pos_w, com_lin_vel_w: [N, 3] of the whole robot.
        com_height: [N] centre of mass above the ground below it, m.
        foot_pos_w, foot_normal_w, foot_lin_vel_w, foot_force_w: [N, 2, 3] sole centre, sole's up axis, m/s, ground
            force in N.
        foot_height: [N, 2] sole centre above the ground below it, m.
        foot_contact: [N, 2] bool.
        body_force: [N] ground force on everything but the feet, N.
    """

    def __init__(self, sim: Simulation, robot: Robot, terrain: TerrainQueries) -> None:
        self._terrain = terrain
        self._sensordata = sim.read("sensordata")  # [N, S]
        self._actuator_force = sim.read("actuator_force")  # [N, J]
        model = sim.model
        self._slices = {
            model.sensor(i).name: slice(model.sensor_adr[i], model.sensor_adr[i] + model.sensor_dim[i])
            for i in range(model.nsensor)
        }
        joints = robot.joint_names
        self._joint_pos = slice(
            self._slices[f"joint_pos/{joints[0]}"].start, self._slices[f"joint_pos/{joints[-1]}"].stop
        )
        self._joint_vel = slice(
            self._slices[f"joint_vel/{joints[0]}"].start, self._slices[f"joint_vel/{joints[-1]}"].stop
        )
        self.refresh()

    def refresh(self, broken: Tensor | None = None) -> None:
        """Reads the simulation and derives everything from it.

        Args:
            broken: [N] bool; worlds that diverged. They read zero, so that nothing spreads into sums over worlds
                before they are reset.
        """
        data = _fresh(self._sensordata, broken)
        take = self._slices

        def feet(name: str) -> Tensor:
            first, last = (take[f"{name}/{side}"] for side in SIDES)
            return data[:, first.start : last.stop].view(-1, 2, 3)

        self.joint_pos = data[:, self._joint_pos]
        self.joint_vel = data[:, self._joint_vel]
        self.joint_torque = _fresh(self._actuator_force, broken)
        self.root_pos_w = data[:, take["root_pos_w"]]
        self.root_quat_w = data[:, take["root_quat_w"]]
        self.root_lin_vel_w = data[:, take["root_lin_vel_w"]]
        self.root_ang_vel_b = data[:, take["root_ang_vel_b"]]
        self.torso_quat_w = data[:, take["torso_quat_w"]]
        self.torso_ang_vel_w = data[:, take["torso_ang_vel_w"]]
        self.com_pos_w = data[:, take["com_pos_w"]]
        self.com_lin_vel_w = data[:, take["com_lin_vel_w"]]
        self.foot_pos_w = feet("foot_pos_w")
        self.foot_normal_w = feet("foot_normal_w")
        self.foot_lin_vel_w = feet("foot_lin_vel_w")
        self.foot_force_w = feet("foot_force_w")
        self.foot_contact = self.foot_force_w.norm(dim=2) > CONTACT_FORCE
        self.body_force = (data[:, take["robot_force_w"]] - self.foot_force_w.sum(dim=1)).norm(dim=1)

        self.projected_gravity_b = -quaternion.up_in_body(self.root_quat_w)
        self.root_lin_vel_b = quaternion.rotate_inverse(self.root_quat_w, self.root_lin_vel_w)
        self.heading_w = quaternion.yaw(self.root_quat_w)
        self._refresh_ground()

    def _refresh_ground(self) -> None:
        points = torch.cat([self.root_pos_w[:, None], self.com_pos_w[:, None], self.foot_pos_w], dim=1)  # [N, 4, 3]
        height = points[:, :, 2] - self._terrain.height(points[:, :, :2])  # [N, 4]
        self.root_height, self.com_height, self.foot_height = height[:, 0], height[:, 1], height[:, 2:]
        self.slope_normal_w = self._terrain.slope_normal(self.root_pos_w[:, :2])
        n = self.slope_normal_w
        cos, sin = self.heading_w.cos(), self.heading_w.sin()
        # The forward direction is the one in the tangent plane that lies over the heading:
        # its rise follows from n . t = 0.
        rise = -(n[:, 0] * cos + n[:, 1] * sin) / n[:, 2]
        self.slope_pitch = torch.atan(rise)
        self._forward_w = torch.nn.functional.normalize(torch.stack([cos, sin, rise], dim=1), dim=1)
        self._left_w = torch.linalg.cross(n, self._forward_w)
        self.root_lin_vel_t = self.along_ground(self.root_lin_vel_w)

    def along_ground(self, v: Tensor) -> Tensor:
        """Vectors `v` [N, 3] of the world frame, in the slope frame of the robot's heading:
        forward, left, out of the ground."""
        forward, left, n = self._forward_w, self._left_w, self.slope_normal_w
        return torch.stack([(v * forward).sum(dim=1), (v * left).sum(dim=1), (v * n).sum(dim=1)], dim=1)


def _fresh(reading: Tensor, broken: Tensor | None) -> Tensor:
    """A copy of a live reading [N, d], zero where `broken` [N] holds."""
    return reading.clone() if broken is None else reading.masked_fill(broken[:, None], 0.0)
