"""The rollout file: one walk of one robot, with everything that a viewer shows. Format 1.

A rollout is a NumPy archive (`numpy.load` opens it, nothing in it is pickled) of one array `header`, a JSON text, of
`terrain_heights` and of one array per column below, one row for each control step.
A row holds the world at the end of its step, before a robot that has fallen is put up again. Lengths are in metres,
times in seconds, angles in rad, forces in N, torques in Nm, quaternions (w, x, y, z); `_w` is the world frame, `_t` the
frame along the ground in the heading direction. Numbers are float32, masks bool, counts int32.

A reader of format 1 may ignore what it does not know; a column that changes its meaning raises the number. The header:

    format, version         "humoslope-rollout", 1
    task, label             the registered task; what viewers call this rollout
    checkpoint              path, sha256, iteration, total_steps, training (a sentence on the harness)
    code, recorded          commit and state of the checkout; date and time of the recording, UTC
    physics                 backend, timestep, decimation, cone
    dt                      control step, s
    protocol                what was asked for: speed, seconds, friction, pushes, seed
    robot                   name, urdf (the whole text), root (its link), joint_names, default_joint_pos, action_scale,
                            effort_limit
    reward_terms            names of the columns of `reward`
    terrain                 name, grade (degrees), cell, origin [x, y of heights[0, 0]], tile_origin, tile_length,
                            tile_width
    events                  list of {time, kind, text}; kinds are fall, push, ground and end
"""

from __future__ import annotations

import json
import zipfile
import zlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from humoslope.errors import UserError
from humoslope.files import write_atomically

NAME, VERSION = "humoslope-rollout", 1

Array = NDArray[np.float32]
Mask = NDArray[np.bool_]


class Event(NamedTuple):
    """Something that happened at one moment."""

    time: float
    kind: str
    text: str


@dataclass(frozen=True)
class Columns:
    """What is recorded of every control step; T rows, J joints, R reward terms.

    Attributes:
        time: [T] since the start.
        episode: [T] counts the robot's starts, from 0.
        root_pos_w, root_quat_w, root_lin_vel_w: [T, 3 or 4].
        root_ang_vel_b: [T, 3] in the root's frame.
        root_lin_vel_t: [T, 3] forward, left and out of the ground.
        root_height: [T] above the ground below.
        joint_pos, joint_vel, joint_torque: [T, J].
        action: [T, J] as the policy gave it; `joint_target` is what the joints were told.
        command: [T, 3] forward and left along the ground, yaw rate.
        com_pos_w, com_lin_vel_w: [T, 3] of the whole robot.
        com_height: [T] above the ground below.
        com_height_target: [T] that the task asked for; NaN where it asks for none.
        foot_pos_w, foot_force_w: [T, 2, 3] left and right sole centre, and the ground's force on the foot.
        reward: [T, R] weighted, per second.
        slope, bank: [T] of the ground around the robot, positive where it rises ahead and to the left.
        ground_normal_w: [T, 3] of the plane fitted to the ground around the robot.
        uphill, downhill: [T] whether that plane counts as a slope up or down.
        zmp_anchor_w, zmp_normal_w: [T, 3] support anchor, and normal of the support plane.
        zmp_w: [T, 3] zero-moment point on that plane; the anchor where it is undefined.
        zmp_valid: [T] whether it is defined.
    """

    time: Array
    episode: NDArray[np.int32]
    root_pos_w: Array
    root_quat_w: Array
    root_lin_vel_w: Array
    root_ang_vel_b: Array
    root_lin_vel_t: Array
    root_height: Array
    joint_pos: Array
    joint_vel: Array
    joint_torque: Array
    action: Array
    command: Array
    com_pos_w: Array
    com_lin_vel_w: Array
    com_height: Array
    com_height_target: Array
    foot_pos_w: Array
    foot_force_w: Array
    reward: Array
    slope: Array
    bank: Array
    ground_normal_w: Array
    uphill: Mask
    downhill: Mask
    zmp_anchor_w: Array
    zmp_normal_w: Array
    zmp_w: Array
    zmp_valid: Mask

    def __len__(self) -> int:
        return len(self.time)


SCALARS = ("time", "root_height", "com_height", "com_height_target", "slope", "bank")
MASKS = ("uphill", "downhill", "zmp_valid")
WIDTHS: dict[str, tuple[int | str, ...]] = {
    **{field.name: (3,) for field in fields(Columns)},
    **dict.fromkeys((*SCALARS, *MASKS, "episode"), ()),
    **dict.fromkeys(("joint_pos", "joint_vel", "joint_torque", "action"), ("J",)),
    **dict.fromkeys(("foot_pos_w", "foot_force_w"), (2, 3)),
    "root_quat_w": (4,),
    "reward": ("R",),
}
"""Shape of a row of each column."""
HEADER: dict[str, tuple[str, ...]] = {
    "": ("task", "label", "checkpoint", "dt", "reward_terms", "events"),
    "robot": ("name", "urdf", "root", "joint_names", "default_joint_pos", "action_scale", "effort_limit"),
    "terrain": ("name", "grade", "cell", "origin", "tile_origin", "tile_length", "tile_width"),
}
"""What viewers need of the header, by section."""


@dataclass(frozen=True)
class Rollout:
    """A recorded walk: `header` as documented above, `columns`, the `terrain_heights` [nx, ny] and the events."""

    header: dict[str, Any]
    columns: Columns
    terrain_heights: Array
    events: tuple[Event, ...]

    @property
    def joint_names(self) -> list[str]:
        """Of the columns over joints."""
        names: list[str] = self.header["robot"]["joint_names"]
        return names

    @property
    def joint_target(self) -> Array:
        """[T, J] position that each joint was told to take, rad."""
        robot = self.header["robot"]
        scale, default = (np.array(robot[name], np.float32) for name in ("action_scale", "default_joint_pos"))
        target: Array = default + scale * self.columns.action
        return target

    def save(self, path: Path) -> None:
        """Writes the file in one step."""
        header = self.header | {"format": NAME, "version": VERSION, "events": [e._asdict() for e in self.events]}
        arrays: dict[str, Any] = {f.name: getattr(self.columns, f.name) for f in fields(Columns)}
        arrays |= {"header": np.array(json.dumps(header)), "terrain_heights": self.terrain_heights}

        def write(temporary: Path) -> None:
            with temporary.open("wb") as file:  # given a path, NumPy would append a suffix
                np.savez_compressed(file, **arrays)

        write_atomically(path, write)


def load_rollout(path: Path) -> Rollout:
    """Reads a rollout file; nothing in it is executed.

    Raises:
        UserError: If the file is missing, broken, no rollout, or of a newer format.
    """
    if not path.is_file():
        raise UserError(f"rollout '{path}' does not exist.")
    try:
        with np.load(path, allow_pickle=False) as archive:
            if "header" not in archive.files:
                raise foreign(path)
            header = json.loads(str(archive["header"]))
            _check_header(path, header)
            arrays = {name: archive[name] for name in (*WIDTHS, "terrain_heights") if name in archive.files}
    except OSError as error:
        raise UserError(f"rollout '{path}' cannot be read: {error.strerror or error}.") from None
    except (ValueError, EOFError, KeyError, TypeError, AttributeError, zipfile.BadZipFile, zlib.error):
        raise UserError(f"rollout '{path}' is broken or truncated, or no rollout at all; record it anew.") from None
    _check_arrays(path, header, arrays)
    terrain = arrays.pop("terrain_heights")
    return Rollout(header, Columns(**arrays), terrain, tuple(Event(**event) for event in header["events"]))


def foreign(path: Path) -> UserError:
    """The error for a file that something else wrote."""
    return UserError(f"'{path}' is not a HumoSlope rollout; `humoslope record` writes one.")


def _check_header(path: Path, header: Any) -> None:
    if not isinstance(header, dict) or header.get("format") != NAME:
        raise foreign(path)
    if header["version"] > VERSION:
        raise UserError(
            f"rollout '{path}' has format {header['version']}, of a newer HumoSlope; this one reads up to {VERSION}."
        )
    for section, names in HEADER.items():
        for name in names:
            if name not in (header.get(section, {}) if section else header):
                raise UserError(f"rollout '{path}' is broken: its header lacks '{section}{'.' * bool(section)}{name}'.")


def _check_arrays(path: Path, header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    sizes = {"J": len(header["robot"]["joint_names"]), "R": len(header["reward_terms"])}
    rows = len(np.atleast_1d(arrays.get("time", ())))
    if rows == 0:
        raise UserError(f"rollout '{path}' holds no time steps; record it anew.")
    for name, width in WIDTHS.items():
        shape = (rows, *(sizes[n] if isinstance(n, str) else n for n in width))
        found = arrays[name].shape if name in arrays else None
        if found != shape:
            has = "is missing" if found is None else f"has shape {found}"
            raise UserError(f"rollout '{path}' is broken: '{name}' {has}; it must have shape {shape}.")
    if (
        "terrain_heights" not in arrays
        or arrays["terrain_heights"].ndim != 2
        or min(arrays["terrain_heights"].shape) < 2
    ):
        raise UserError(f"rollout '{path}' is broken: 'terrain_heights' must be a grid of heights.")
