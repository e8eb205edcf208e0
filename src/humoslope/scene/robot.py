"""Description of a robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco


@dataclass(frozen=True)
class MeshVisual:
    """Mesh on a link.

    Attributes:
        link: Name of the link.
        file: Name of an STL file, in metres and in the link's frame.
        colour: (red, green, blue) in 0..255.
        position: Offset of the mesh in the link's frame, m.
    """

    link: str
    file: str
    colour: tuple[int, int, int]
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class MeshSource:
    """Python package that carries the visual meshes of a robot.

    Attributes:
        robots: Names of the robots whose links these are, such as one model with and one without contact of its parts.
        package: Name on the package index.
        version: Version on the package index.
        sha256: Checksum of the wheel, hexadecimal.
        folder: Folder of the meshes in the wheel.
        visuals: Meshes and their links.
        licence: Note on the licence of the meshes, for the user.
    """

    robots: tuple[str, ...]
    package: str
    version: str
    sha256: str
    folder: str
    visuals: tuple[MeshVisual, ...]
    licence: str


@dataclass(frozen=True, eq=False)  # hashed by identity: caches that are read in every step use it as a key
class Robot:
    """Legged robot; every tuple over joints follows `joint_names`.

    Attributes:
        name: Name in tables and messages.
        make_spec: Function that builds a fresh `MjSpec`: a free joint on `root_body`, one position actuator per joint
            (same names and order as `joint_names`), a site at each sole; no ground, and no sensors of those that
            `humoslope.scene.sensors.add_robot_sensors` adds to it.
        urdf: Path of a URDF with the same links and joints and with visual shapes, for viewers.
        root_body: Name of the body with the free joint.
        torso_body: Name of the body that carries the upper body; the harness acts on it.
        imu_site: Name of the site at which angular velocity and gravity are measured.
        foot_bodies: Names of the left and the right foot.
        foot_sites: Names of the left and the right sole centre, z axis up out of the foot.
        foot_geoms: Names of the geoms that touch the ground under the left and the right foot.
        shin_bodies: Names of the left and the right lower leg; only these and the feet may touch the ground without it
            being a fall.
        joint_names: Names of the actuated joints, in the order of actions and of the deployed controller.
        default_joint_pos: Joint positions of a zero action, rad.
        default_root_height: Height of `root_body` above level ground in that pose, m.
        action_scale: Change of the joint target per unit of action, rad.
        stiffness: Position gains, Nm/rad.
        damping: Velocity gains, Nm s/rad.
        effort_limit: Highest joint torques, Nm.
        total_mass: Mass of the whole robot, kg.
        meshes: Source of its visual meshes, if there is one.
    """

    name: str
    make_spec: Callable[[], mujoco.MjSpec]
    urdf: Path
    root_body: str
    torso_body: str
    imu_site: str
    foot_bodies: tuple[str, str]
    foot_sites: tuple[str, str]
    foot_geoms: tuple[tuple[str, ...], tuple[str, ...]]
    shin_bodies: tuple[str, str]
    joint_names: tuple[str, ...]
    default_joint_pos: tuple[float, ...]
    default_root_height: float
    action_scale: tuple[float, ...]
    stiffness: tuple[float, ...]
    damping: tuple[float, ...]
    effort_limit: tuple[float, ...]
    total_mass: float
    meshes: MeshSource | None = None

    @property
    def num_joints(self) -> int:
        """Number of actuated joints."""
        return len(self.joint_names)
