"""The rollout file: one walk of one robot, with everything that a viewer shows. Format 1.

A rollout is a NumPy archive (`numpy.load` opens it, nothing in it is pickled; its zip comment is its SHA-256) of one
array `header`, a JSON text, of `terrain_heights` and of one array per column below, one row for each control step.
A row holds the state at the end of its step, before a robot that has fallen is reset. Lengths are in metres,
times in seconds, angles in rad, forces in N, torques in Nm, quaternions (w, x, y, z); `_w` is the world frame, `_t` the
frame along the ground in the heading direction. Numbers are float32, masks bool, counts int32.

A reader of format 1 may ignore fields it does not know; a column that changes its meaning increases the number. The
header:

    format, version         "humoslope-rollout", 1
    task, label             the registered task; the name of this rollout in viewers
    checkpoint              path, sha256, iteration, total_steps, training (a sentence on the harness)
    code, recorded          commit and state of the checkout; date and time of the recording, UTC
    physics                 backend, timestep, decimation, cone
    dt                      control step, s
    protocol                settings of the recording: speed, seconds, friction, pushes, seed
    robot                   name, urdf (the whole text), root (its link), joint_names, default_joint_pos, action_scale,
                            effort_limit
    reward_terms            names of the columns of `reward`
    terrain                 name, grade (degrees), cell, origin [x, y of heights[0, 0]], tile_origin, tile_length,
                            tile_width
    events                  list of {time, kind, text}; kinds are fall, cause, push, touch, ground, state and end
"""

from __future__ import annotations

import json
import zipfile
import zlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from humoslope.errors import UserError, unknown
from humoslope.seal import read_arrays, write_arrays
from humoslope.shipped import found

NAME, VERSION = "humoslope-rollout", 1
LARGEST = 1e9
"""Largest number that is believed, in any unit."""

Array = NDArray[np.float32]
Mask = NDArray[np.bool_]


class Event(NamedTuple):
    """An event at one moment: time in s, kind and description."""

    time: float
    kind: str
    text: str


@dataclass(frozen=True)
class Columns:
    """Recorded quantities, one row for each control step; T rows, J joints, R reward terms.

    Attributes:
        time: [T] time since the start.
        episode: [T] number of the robot's start, from 0.
        root_pos_w: [T, 3] position of the root.
        root_quat_w: [T, 4] orientation of the root.
        root_lin_vel_w: [T, 3] velocity of the root.
        root_ang_vel_b: [T, 3] angular velocity of the root in its own frame.
        root_lin_vel_t: [T, 3] velocity of the root forward, left and out of the ground.
        root_height: [T] height of the root above the ground below it.
        joint_pos: [T, J] joint positions.
        joint_vel: [T, J] joint velocities.
        joint_torque: [T, J] joint torques.
        action: [T, J] output of the policy; the joint target is default_joint_pos + action_scale * action.
        command: [T, 3] commanded speed forward and left along the ground, and yaw rate.
        com_pos_w: [T, 3] position of the robot's centre of mass.
        com_lin_vel_w: [T, 3] velocity of the robot's centre of mass.
        com_height: [T] height of the centre of mass above the ground below it.
        com_height_target: [T] target of the task for that height; NaN if it has none.
        foot_pos_w: [T, 2, 3] centres of the left and the right sole.
        foot_force_w: [T, 2, 3] force of the ground on the left and the right foot.
        self_force: [T] largest force between two parts of the robot; NaN in files that were recorded without it.
        reward: [T, R] weighted reward of each term, per second.
        slope: [T] slope of the ground around the robot, positive where it rises ahead.
        bank: [T] bank of the ground around the robot, positive where it rises to the left.
        ground_normal_w: [T, 3] normal of the plane fitted to the ground around the robot.
        uphill: [T] True where that plane counts as a slope up.
        downhill: [T] True where that plane counts as a slope down.
        zmp_anchor_w: [T, 3] support anchor.
        zmp_normal_w: [T, 3] normal of the support plane.
        zmp_w: [T, 3] zero-moment point on that plane; the anchor where it is undefined.
        zmp_valid: [T] True where the zero-moment point is defined.
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
    self_force: Array
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


SCALARS = ("time", "root_height", "com_height", "com_height_target", "self_force", "slope", "bank")
MASKS = ("uphill", "downhill", "zmp_valid")
WIDTHS: dict[str, tuple[int | str, ...]] = {
    **{field.name: (3,) for field in fields(Columns)},
    **dict.fromkeys((*SCALARS, *MASKS, "episode"), ()),
    **dict.fromkeys(("joint_pos", "joint_vel", "joint_torque", "action"), ("J",)),
    **dict.fromkeys(("foot_pos_w", "foot_force_w"), (2, 3)),
    "root_quat_w": (4,),
    "reward": ("R",),
}
"""Shape of one row of each column; J joints, R reward terms."""
TEXT, TEXTS = "a text", "a list of texts, all different"
NUMBER, NUMBERS, POSITIVE, COUNT = "a number", "a list of numbers", "a positive number", "a whole number"
COUNT_OR_NULL = "a whole number, or null"
HEADER = {
    **dict.fromkeys(("task", "label", "code", "recorded"), TEXT),
    "checkpoint.sha256": TEXT,
    "checkpoint.training": TEXT,
    "checkpoint.iteration": COUNT_OR_NULL,
    "dt": POSITIVE,
    "reward_terms": TEXTS,
    "robot.name": TEXT,
    "robot.urdf": TEXT,
    "robot.root": TEXT,
    "robot.joint_names": TEXTS,
    **dict.fromkeys(("robot.default_joint_pos", "robot.action_scale", "robot.effort_limit"), NUMBERS),
    "terrain.name": TEXT,
    "terrain.grade": NUMBER,
    "terrain.cell": POSITIVE,
    "terrain.origin": NUMBERS,
    "terrain.tile_origin": NUMBERS,
    "terrain.tile_length": POSITIVE,
    "terrain.tile_width": POSITIVE,
}
"""Fields of the header that viewers need, and what they must be."""
UNIT = ("root_quat_w", "ground_normal_w", "zmp_normal_w")
"""Columns of vectors of length 1."""
TURNING = ("revolute", "continuous")
"""Types of the joints that a rollout can move."""


@dataclass(frozen=True)
class Rollout:
    """A recorded walk.

    Attributes:
        header: Header as documented in the module.
        columns: Recorded quantities.
        terrain_heights: [nx, ny] heights of the ground, m.
        events: Events in the order of time.
    """

    header: dict[str, Any]
    columns: Columns
    terrain_heights: Array
    events: tuple[Event, ...]

    @property
    def joint_names(self) -> list[str]:
        """Names of the joints in the columns over joints."""
        names: list[str] = self.header["robot"]["joint_names"]
        return names

    def save(self, path: Path, **more: NDArray[Any]) -> None:
        """Writes the file, sealed, in one step, with `more` arrays that only their writer's own reader knows."""
        header = self.header | {"format": NAME, "version": VERSION, "events": [e._asdict() for e in self.events]}
        arrays: dict[str, Any] = {f.name: getattr(self.columns, f.name) for f in fields(Columns)}
        arrays |= {"header": np.array(json.dumps(header)), "terrain_heights": self.terrain_heights}
        if taken := sorted(set(more) & set(arrays)):
            raise ValueError(f"arrays of a rollout cannot be replaced: {', '.join(taken)}")
        write_arrays(path, arrays | more)


def load_rollout(path: Path) -> Rollout:
    """Reads a rollout file, also one that comes with HumoSlope; nothing in it is executed.

    Raises:
        UserError: If the file is missing, broken, no rollout, of a newer format, or contradicts itself.
    """
    path = found(path)
    if not path.is_file():
        raise UserError(f"rollout '{path}' does not exist.")
    try:
        archive = read_arrays(path)
        if "header" not in archive:
            raise foreign(path)
        header = json.loads(str(archive["header"]))
        if not isinstance(header, dict) or header.get("format") != NAME:
            raise foreign(path)
        arrays = {name: archive[name] for name in (*WIDTHS, "terrain_heights") if name in archive}
    except OSError as error:
        raise UserError(f"rollout '{path}' cannot be read: {error.strerror or error}.") from None
    except (
        *(ValueError, EOFError, KeyError, TypeError, AttributeError, RecursionError, MemoryError),
        *(NotImplementedError, zipfile.BadZipFile, zlib.error),
    ):
        raise UserError(f"rollout '{path}' is broken or truncated, or no rollout at all; record it anew.") from None
    try:
        _check_header(header)
        columns, heights = _check_arrays(header, arrays)
        _check_terrain(header["terrain"], heights)
        _check_robot(header["robot"])
        events = tuple(_event(event) for event in header["events"])
    except UserError as error:
        raise UserError(f"rollout '{path}' {error}") from None
    return Rollout(header, columns, heights, events)


def foreign(path: Path) -> UserError:
    """Returns the error for a file of another program."""
    return UserError(f"'{path}' is not a HumoSlope rollout; `humoslope record` writes one.")


def _broken(what: str, found: object, right: str) -> UserError:
    shown = f"'{found}'" if isinstance(found, str) else str(found)
    return UserError(f"is broken: {what} is {shown if len(shown) <= 60 else shown[:57] + '...'}; it must be {right}.")


def _check_header(header: dict[str, Any]) -> None:
    version: Any = header.get("version")
    if not _is_a(COUNT, version):
        raise _broken("its format", version, COUNT)
    if version > VERSION:
        raise UserError(f"has format {version}, of a newer HumoSlope; this one reads up to {VERSION}.")
    for field, kind in HEADER.items():
        section, _, name = field.rpartition(".")
        values = header.get(section, {}) if section else header
        if not isinstance(values, dict) or name not in values:
            raise UserError(f"is broken: its header lacks '{field}'.")
        if not _is_a(kind, values[name]):
            raise _broken(f"'{field}' in its header", values[name], kind)
    joints = len(header["robot"]["joint_names"])
    for field, count in (
        *((f"robot.{name}", joints) for name in ("default_joint_pos", "action_scale", "effort_limit")),
        ("terrain.origin", 2),
        ("terrain.tile_origin", 3),
    ):
        section, _, name = field.partition(".")
        found = len(header[section][name])
        if found != count:
            raise UserError(f"is broken: '{field}' in its header has {found} numbers; it must have {count}.")
    if min(header["robot"]["effort_limit"], default=1.0) <= 0.0:
        raise _broken("'robot.effort_limit' in its header", min(header["robot"]["effort_limit"]), POSITIVE)
    if not isinstance(header.get("events"), list):
        raise _broken("'events' in its header", header.get("events"), "a list")


def _is_a(kind: str, value: Any) -> bool:
    """True if a value from JSON is what one of the words in `HEADER` says."""
    if kind in (TEXTS, NUMBERS):
        one = TEXT if kind == TEXTS else NUMBER
        distinct = kind == NUMBERS or (isinstance(value, list) and len(set(map(str, value))) == len(value))
        return isinstance(value, list) and all(_is_a(one, item) for item in value) and distinct
    if kind == TEXT:
        return isinstance(value, str)
    if kind == COUNT_OR_NULL:
        return value is None or _is_a(COUNT, value)
    if isinstance(value, bool) or not isinstance(value, int if kind == COUNT else int | float):
        return False
    return kind == COUNT or (abs(value) <= LARGEST and (kind == NUMBER or value > 0.0))


def _check_arrays(header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> tuple[Columns, Array]:
    """Returns the columns and the heights of the ground in their types."""
    sizes = {"J": len(header["robot"]["joint_names"]), "R": len(header["reward_terms"])}
    rows = len(np.atleast_1d(arrays.get("time", ())))
    if rows == 0:
        raise UserError("holds no time steps; record it anew.")
    arrays.setdefault("self_force", np.full(rows, np.nan, np.float32))  # not recorded until November 2026
    columns: dict[str, NDArray[Any]] = {}
    for name, width in WIDTHS.items():
        shape = (rows, *(sizes[n] if isinstance(n, str) else n for n in width))
        found = arrays[name].shape if name in arrays else None
        if found != shape:
            has = "is missing" if found is None else f"has shape {found}"
            raise UserError(f"is broken: '{name}' {has}; it must have shape {shape}.")
        columns[name] = _numbers(name, arrays[name])
    if np.any(np.diff(columns["time"], prepend=0.0) <= 0.0):
        raise UserError("is broken: 'time' does not increase.")
    if np.any(np.diff(columns["episode"], prepend=0) < 0):
        raise UserError("is broken: 'episode' decreases.")
    for name in UNIT:
        row = int(np.argmax(np.abs(np.linalg.norm(columns[name], axis=1) - 1.0)))
        if not abs(np.linalg.norm(columns[name][row]) - 1.0) < 1e-2:
            raise _broken(f"'{name}' in row {row}", columns[name][row], "of length 1")
    heights = arrays.get("terrain_heights", np.zeros(0))
    if heights.ndim != 2 or min(heights.shape) < 2:
        raise UserError("is broken: 'terrain_heights' must be a grid of heights.")
    return Columns(**columns), _numbers("terrain_heights", heights)


def _numbers(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Returns a column in its type; raises UserError where it is not of numbers, or not finite."""
    kind: Any = np.bool_ if name in MASKS else np.int32 if name == "episode" else np.float32
    if values.dtype.kind not in {np.bool_: "b", np.int32: "iu", np.float32: "fiu"}[kind]:
        raise UserError(f"is broken: '{name}' is of type {values.dtype}; it must be {np.dtype(kind).name}.")
    with np.errstate(over="ignore"):
        typed: NDArray[Any] = values.astype(kind)
    if kind is np.float32:
        absent = np.isnan(typed)
        absent &= name == "com_height_target" or (name == "self_force" and bool(absent.all()))
        bad = np.argwhere(~(np.abs(typed) <= LARGEST) & ~absent)
        if len(bad):
            raise _broken(f"'{name}' in row {bad[0][0]}", typed[tuple(bad[0])], "finite")
    return typed


def _check_terrain(terrain: dict[str, Any], heights: Array) -> None:
    """Raises UserError if the robot's tile does not lie on the grid of heights."""
    size = terrain["cell"] * (np.array(heights.shape) - 1)
    start_x, middle_y = np.array(terrain["tile_origin"][:2]) - terrain["origin"]
    low = np.array([start_x, middle_y - 0.5 * terrain["tile_width"]])
    high = low + np.array([terrain["tile_length"], terrain["tile_width"]])
    half = 0.5 * terrain["cell"]
    if (low < -half).any() or (high > size + half).any() or min(terrain["tile_length"], terrain["tile_width"]) < half:
        raise UserError("is broken: its tile does not lie within 'terrain_heights'.")


def _check_robot(robot: dict[str, Any]) -> None:
    """Raises UserError if the URDF lacks the root or a joint of the header."""
    try:
        urdf = ElementTree.fromstring(robot["urdf"])
    except ElementTree.ParseError:
        raise UserError("is broken: its URDF cannot be read; record it anew.") from None
    if robot["root"] not in (links := [link.get("name", "") for link in urdf.iter("link")]):
        raise UserError(f"is broken: its URDF lacks the root; {unknown('link', robot['root'], links)}")
    joints = {joint.get("name", ""): joint.get("type", "") for joint in urdf.iter("joint")}
    for name in robot["joint_names"]:
        if name not in joints:
            raise UserError(f"is broken: its URDF lacks a joint of its header; {unknown('joint', name, joints)}")
        if joints[name] not in TURNING:
            raise _broken(f"the type of joint '{name}' in its URDF", joints[name], " or ".join(TURNING))


def _event(event: Any) -> Event:
    """Returns an event of the header."""
    kinds = {"time": NUMBER, "kind": TEXT, "text": TEXT}
    if not isinstance(event, dict) or not all(_is_a(kind, event.get(name)) for name, kind in kinds.items()):
        raise _broken("an event in its header", event, "an object with time, kind and text")
    return Event(float(event["time"]), event["kind"], event["text"])
