"""Named, batched signals of the robot on its terrain, all of one instant."""

from __future__ import annotations

from functools import cached_property

import torch
from torch import Tensor

from humoslope.scene.robot import Robot
from humoslope.scene.sensors import SIDES
from humoslope.sim.protocol import Simulation
from humoslope.slope import quaternion
from humoslope.terrain.queries import TerrainQueries

CONTACT_FORCE = 1.0
"""Force above which a foot is in contact, N (as in Unitree RL Lab and Isaac Lab)."""


class Signals:
    """State of the robots as terms read it, all of one instant.

    `refresh` replaces every tensor; those of the refresh before are never written again. Signals that the policy does
    not observe are computed on first use, which keeps the second refresh of a step, after resets, cheap.

    Frames: `_w` world, `_b` root body, `_t` along the ground: forward in the heading direction, left, out of the slope.

    Attributes:
        joint_pos: [N, J] joint positions, rad.
        joint_vel: [N, J] joint velocities, rad/s.
        joint_torque: [N, J] actuator torques, Nm.
        root_pos_w: [N, 3] position of the root, m.
        root_quat_w: [N, 4] orientation of the root.
        root_lin_vel_w: [N, 3] velocity of the root, m/s.
        root_lin_vel_b: [N, 3] velocity of the root, m/s.
        root_ang_vel_b: [N, 3] angular velocity at the IMU, rad/s.
        projected_gravity_b: [N, 3] unit vector of gravity in the root frame.
        heading_w: [N] yaw of the root, rad.
        root_height: [N] height of the root above the ground below it, m.
        torso_quat_w: [N, 4] orientation of the torso.
        torso_ang_vel_w: [N, 3] angular velocity of the torso, rad/s.
        com_pos_w: [N, 3] centre of mass of the whole robot, m.
        com_lin_vel_w: [N, 3] velocity of the centre of mass, m/s.
        com_ang_mom_w: [N, 3] angular momentum of the whole robot about its centre of mass, kg m^2/s.
        com_height: [N] height of the centre of mass above the ground below it, m.
        foot_pos_w: [N, 2, 3] sole centres, left and right, m.
        foot_normal_w: [N, 2, 3] up axes of the soles.
        foot_lin_vel_w: [N, 2, 3] velocities of the sole centres, m/s.
        foot_force_w: [N, 2, 3] ground forces on the feet, N.
        foot_force: [N, 2] magnitudes of the ground forces, N.
        foot_height: [N, 2] heights of the sole centres above the ground below them, m.
        foot_contact: [N, 2] bool, whether the ground force exceeds `CONTACT_FORCE`.
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

    def refresh(self, diverged: Tensor | None = None) -> None:
        """Reads the simulation and derives everything from it.

        Args:
            diverged: [N] bool; envs that diverged, none by default. Their readings become zero, so that no NaN spreads
                into sums over envs before they are reset.
        """
        data = _fresh(self._sensordata, diverged)
        take = self._slices

        def feet(name: str) -> Tensor:
            first, last = (take[f"{name}/{side}"] for side in SIDES)
            return data[:, first.start : last.stop].view(-1, 2, 3)

        self.joint_pos = data[:, self._joint_pos]
        self.joint_vel = data[:, self._joint_vel]
        self.joint_torque = _fresh(self._actuator_force, diverged)
        self.root_pos_w = data[:, take["root_pos_w"]]
        self.root_quat_w = data[:, take["root_quat_w"]]
        self.root_lin_vel_w = data[:, take["root_lin_vel_w"]]
        self.root_ang_vel_b = data[:, take["root_ang_vel_b"]]
        self.torso_quat_w = data[:, take["torso_quat_w"]]
        self.torso_ang_vel_w = data[:, take["torso_ang_vel_w"]]
        self.com_pos_w = data[:, take["com_pos_w"]]
        self.com_lin_vel_w = data[:, take["com_lin_vel_w"]]
        self.com_ang_mom_w = data[:, take["com_ang_mom_w"]]
        self.foot_pos_w = feet("foot_pos_w")
        self.foot_normal_w = feet("foot_normal_w")
        self.foot_lin_vel_w = feet("foot_lin_vel_w")
        self.foot_force_w = feet("foot_force_w")
        self.foot_force = self.foot_force_w.norm(dim=2)
        self.foot_contact = self.foot_force > CONTACT_FORCE
        self._robot_force_w = data[:, take["robot_force_w"]]
        self._shin_force_w = feet("shin_force_w")
        self._self_force = data[:, take["self_force"]]  # [N, 3] in the frame of the contact

        rotation = quaternion.matrix(self.root_quat_w)  # [N, 3, 3]
        self.projected_gravity_b = -rotation[:, 2]
        self.root_lin_vel_b = (rotation * self.root_lin_vel_w[:, :, None]).sum(dim=1)
        self.heading_w = torch.atan2(rotation[:, 1, 0], rotation[:, 0, 0])
        self._refresh_ground()
        for name in _ON_DEMAND:
            self.__dict__.pop(name, None)

    def _refresh_ground(self) -> None:
        root = self.root_pos_w[:, None]
        points = torch.cat([root, self.com_pos_w[:, None], self.foot_pos_w], dim=1)  # [N, 4, 3]
        # One lookup for all of it: the cost of a lookup hardly depends on the number of points.
        places = torch.cat([points[:, :, :2], self._terrain.around(root[:, 0, :2])], dim=1)  # [N, 8, 2]
        ground = self._terrain.height(places)
        height = points[:, :, 2] - ground[:, :4]
        self.root_height, self.com_height, self.foot_height = height[:, 0], height[:, 1], height[:, 2:]
        self._ground_around = ground[:, 4:]

    def own_sensors(self) -> Tensor:
        """Returns what encoders and IMU read at present, [N, 2 J + 6]: joint positions and velocities, angular velocity
        and direction of gravity in the root frame. Unlike the attributes it needs no `refresh`."""
        data = self._sensordata
        gravity_b = -quaternion.matrix(data[:, self._slices["root_quat_w"]])[:, 2]
        angular = data[:, self._slices["root_ang_vel_b"]]
        return torch.cat([data[:, self._joint_pos], data[:, self._joint_vel], angular, gravity_b], dim=1)

    @cached_property
    def slope_normal_w(self) -> Tensor:
        """[N, 3] unit normal of the ground below the root, at the scale of a step."""
        return self._terrain.slope_normal(self._ground_around)

    @cached_property
    def slope_pitch(self) -> Tensor:
        """[N] inclination of the ground in the heading direction, rad, positive uphill."""
        return torch.atan(self._rise)

    @cached_property
    def root_lin_vel_t(self) -> Tensor:
        """[N, 3] velocity of the root along the ground, m/s."""
        return self.along_ground(self.root_lin_vel_w)

    @cached_property
    def body_force(self) -> Tensor:
        """[N] ground force on everything but the feet, N."""
        return self._body_force_w.norm(dim=1)

    @cached_property
    def upper_force(self) -> Tensor:
        """[N] ground force on everything but feet and shins, N."""
        return (self._body_force_w - self._shin_force_w.sum(dim=1)).norm(dim=1)

    @cached_property
    def shin_force(self) -> Tensor:
        """[N, 2] ground forces on the left and the right shin, N."""
        return self._shin_force_w.norm(dim=2)

    @cached_property
    def self_force(self) -> Tensor:
        """[N] largest force between two parts of the robot, N. Parts that the robot's model lets pass through each
        other have none."""
        return self._self_force.norm(dim=1)

    def along_ground(self, v: Tensor) -> Tensor:
        """Returns vectors `v` [N, 3] of the world frame in the slope frame of the robot's heading:
        forward, left, out of the ground."""
        return (self._along_ground * v[:, None]).sum(dim=2)

    @cached_property
    def _body_force_w(self) -> Tensor:
        return self._robot_force_w - self.foot_force_w.sum(dim=1)

    @cached_property
    def _over_ground(self) -> Tensor:
        """[N, 2] the heading as a horizontal unit vector."""
        return torch.stack([self.heading_w.cos(), self.heading_w.sin()], dim=1)

    @cached_property
    def _rise(self) -> Tensor:
        """[N] rise of the ground per metre along the heading. A direction t that lies over the heading is in the
        tangent plane if n . t = 0."""
        n = self.slope_normal_w
        return -(n[:, :2] * self._over_ground).sum(dim=1) / n[:, 2]

    @cached_property
    def _along_ground(self) -> Tensor:
        """[N, 3, 3] rows: forward, left, out of the ground."""
        over = torch.cat([self._over_ground, self._rise[:, None]], dim=1)
        forward = over / over.norm(dim=1, keepdim=True)
        n = self.slope_normal_w
        return torch.stack([forward, torch.linalg.cross(n, forward), n], dim=1)


_ON_DEMAND = [name for name, value in vars(Signals).items() if isinstance(value, cached_property)]


def _fresh(reading: Tensor, diverged: Tensor | None) -> Tensor:
    """A copy of a live reading [N, d], zero where `diverged` [N] holds."""
    return reading.clone() if diverged is None else reading.masked_fill(diverged[:, None], 0.0)
