"""Source of the published meshes of the Unitree G1, and the meshes of each link.

They are not in this repository. mjlab 1.6.0 contains the 35 files of the 29-joint model of revision 1.0
(https://github.com/unitreerobotics/unitree_ros, g1_description); meshes are assigned to links as in that model.
"""

from __future__ import annotations

from humoslope.scene.robot import MeshSource, MeshVisual

SILVER, BLACK = (179, 179, 179), (51, 51, 51)
SIDES = ("left", "right")

SILVER_PARTS = (
    *("hip_roll", "hip_yaw", "knee", "ankle_pitch"),
    *("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw"),
)
BLACK_PARTS = ("hip_pitch", "ankle_roll")
# Position of logo and head on the torso, m: origin of the torso in that model's waist.
ON_TORSO = (0.0039635, 0.0, -0.044)
# Position of the hands on the wrists, m.
HANDS = {"left": (0.0415, 0.003, 0.0), "right": (0.0415, -0.003, 0.0)}


def _own(link: str, colour: tuple[int, int, int]) -> MeshVisual:
    """Returns the visual of a link whose mesh has the same name."""
    return MeshVisual(link, f"{link}.STL", colour)


VISUALS = (
    _own("pelvis", BLACK),
    MeshVisual("pelvis", "pelvis_contour_link.STL", SILVER),
    MeshVisual("waist_yaw_link", "waist_yaw_link_rev_1_0.STL", SILVER),
    MeshVisual("waist_roll_link", "waist_roll_link_rev_1_0.STL", SILVER),
    MeshVisual("torso_link", "torso_link_rev_1_0.STL", SILVER),
    MeshVisual("torso_link", "logo_link.STL", BLACK, ON_TORSO),
    MeshVisual("torso_link", "head_link.STL", BLACK, ON_TORSO),
    *(_own(f"{side}_{part}_link", SILVER) for side in SIDES for part in SILVER_PARTS),
    *(_own(f"{side}_{part}_link", BLACK) for side in SIDES for part in BLACK_PARTS),
    *(MeshVisual(f"{side}_wrist_yaw_link", f"{side}_rubber_hand.STL", SILVER, HANDS[side]) for side in SIDES),
)

G1_MESHES = MeshSource(
    robots=("unitree_g1", "unitree_g1_solid"),
    package="mjlab",
    version="1.6.0",
    sha256="03d003854e2f44c48330c6dcf4c2253ff7641bb569747846825a21b9efa8540b",
    folder="mjlab/asset_zoo/robots/unitree_g1/xmls/assets",
    visuals=VISUALS,
    licence=(
        "The meshes are Unitree Robotics' (HangZhou YuShu Technology Co., Ltd.), published in unitree_ros under the "
        "BSD 3-Clause License: https://github.com/unitreerobotics/unitree_ros/blob/master/LICENSE"
    ),
)
