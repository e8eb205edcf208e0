"""What the engine needs to know of a robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco


@dataclass(frozen=True)
class MeshVisual:
    """A mesh on a link.

    Attributes:
        link: That wears it.
        file: Name of an STL file, in metres and in the link's frame.
        position: Where it is moved to in that frame, m.
        colour: (red, green, blue) in 0..255.
    """

    link: str
    file: str
    colour: tuple[int, int, int]
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class MeshSource:
    """Where the real look of a robot can be had: a Python package that carries its meshes.

    Attributes:
        package, version: On the package index.
        sha256: Of its wheel, hexadecimal.
        folder: Of the meshes in the wheel.
        visuals: Every mesh on its link.
        licence: What the user should know of their licence.
    """

    package: str
    version: str
    sha256: str
    folder: str
    visuals: tuple[MeshVisual, ...]
    licence: str


@dataclass(frozen=True, eq=False)  # hashed by identity: it is a key of caches that are asked at every step
class Robot:
    """A legged robot, described once; every tuple over joints follows `joint_names`.

    Attributes:
        name: Shown in tables and messages.
        make_spec: Builds a fresh `MjSpec`: a free joint on `root_body`, one position actuator per joint (same names and
            order as `joint_names`), a site at each sole, and no ground.
        urdf: The same links and joints with shapes to draw, for viewers.
        meshes: Where its real look can be had, if anywhere.
        root_body: The body that carries the free joint.
        torso_body: The body that carries the upper body; the harness acts on it.
        imu_site: Where angular velocity and gravity are measured.
        foot_bodies: Left and right foot.
        foot_sites: Left and right sole centre, z axis up out of the foot.
        foot_geoms: Names of the geoms that touch the ground under the left and the right foot.
        shin_bodies: Left and right lower leg; only these and the feet may touch the ground without it being a fall.
        joint_names: The actuated joints, in the order of actions and of the deployed controller.
        default_joint_pos: Pose that a zero action holds, rad.
        default_root_height: Height of `root_body` over the soles' ground in that pose, m.
        action_scale: Joint target moved by one unit of action, rad.
        stiffness: Position gain, Nm/rad.
        damping: Velocity gain, Nm s/rad.
        effort_limit: Largest joint torque, Nm.
        total_mass: kg.
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
