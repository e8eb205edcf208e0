"""Rerun entities of a rollout: robot, ground, and the quantities of the method.

Moving entities are sent in columns, all steps at once: row by row it would take hundreds of times longer.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from humoslope.deploy import rotation
from humoslope.replay.film.follow import follow
from humoslope.replay.rerun import colours
from humoslope.replay.rerun.colours import Colour
from humoslope.replay.robot import RobotShape
from humoslope.replay.rollout import Mask, Rollout
from humoslope.replay.shapes import Shape, ground_shape

TIME, STEP = "time", "step"
"""Timelines: seconds, and control steps."""
FOLLOWED = "followed"
"""Entity that moves with the robot but does not rotate; origin of the 3D views."""
METRES_PER_NEWTON = 1.0 / 700.0
"""Length of force arrows: half a metre for the weight of a G1."""
OVERHEAD = 0.65
"""Height of the velocity arrows above the root, m."""
SUPPORT_PLANE = (0.24, 0.16, 0.002)
"""Half extents of the drawn part of the support plane, m."""
HALF_BAR = 0.3
"""Half the length of the bar through the centre of mass, m."""

MARK_HEIGHT = 0.85
"""Height of the mark of a failure above the root, m: above the head."""
MARKED_S = 1.5
"""Time for which a failure is marked, s."""

Array = NDArray[np.floating]


class Scene:
    """Writes one rollout into a recording.

    Args:
        recording: Recording to write into.
        rollout: The rollout.
        prefix: Prefix of all entity paths, such as "first/".
        meshes: Shape of each link, as in `RobotShape`.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        rollout: Rollout,
        prefix: str = "",
        meshes: Mapping[str, Shape] | None = None,
    ) -> None:
        self._recording, self._rollout, self._prefix = recording, rollout, prefix
        self._robot = RobotShape(rollout.header["robot"]["urdf"], meshes)
        time = rollout.columns.time
        self._times = [rr.TimeColumn(TIME, duration=time), rr.TimeColumn(STEP, sequence=np.arange(1, len(time) + 1))]

    def log(self) -> None:
        """Writes everything in the 3D view, and the events."""
        self._static("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        self._static("world/ground", mesh(ground_shape(self._rollout)))
        self._log_robot()
        self._log_velocity()
        self._log_support()
        self._log_centre_of_mass()
        self._log_ground_normal()
        eye = rr.Transform3D.columns(translation=follow(self._rollout.columns, self._rollout.header["dt"]))
        self._columns(f"world/{FOLLOWED}", eye)
        for side, name in enumerate(("left", "right")):
            feet, force = self._rollout.columns.foot_pos_w[:, side], self._rollout.columns.foot_force_w[:, side]
            self._arrows(f"world/contact/{name}", feet, METRES_PER_NEWTON * force, colours.FORCE)
        self._log_events()
        self._log_failures()

    def _log_robot(self) -> None:
        poses = self._robot.poses(self._rollout)
        for link, shape in self._robot.shapes.items():
            self._static(f"world/robot/{link}", mesh(shape))
            self._moves(f"world/robot/{link}", poses[link].position, poses[link].rotation)

    def _log_velocity(self) -> None:
        columns = self._rollout.columns
        start = columns.root_pos_w + np.array((0.0, 0.0, OVERHEAD), np.float32)
        forward, left, _ = _along(columns.ground_normal_w, columns.root_quat_w)
        commanded = columns.command[:, :1] * forward + columns.command[:, 1:2] * left
        self._arrows("world/velocity/commanded", start, commanded, colours.COMMANDED)
        raised = start + np.array((0.0, 0.0, 0.05), np.float32)
        self._arrows("world/velocity/actual", raised, columns.root_lin_vel_w, colours.ACTUAL)

    def _log_support(self) -> None:
        columns, valid = self._rollout.columns, self._rollout.columns.zmp_valid
        plane = rr.Boxes3D(half_sizes=[SUPPORT_PLANE], colors=[(*colours.SUPPORT, 110)], fill_mode="solid")
        self._static("world/support/plane", plane)
        axes = _along(columns.zmp_normal_w, columns.root_quat_w)
        self._moves("world/support/plane", columns.zmp_anchor_w, np.stack(axes, axis=2))
        self._points("world/support/anchor", columns.zmp_anchor_w, colours.SUPPORT, 0.022)
        self._points("world/support/zmp", columns.zmp_w, colours.ZMP, 0.028, valid)
        rays = np.stack([columns.com_pos_w, columns.zmp_w], axis=1)
        self._lines("world/support/zmp_ray", rays, colours.ZMP, 0.006, valid)

    def _log_centre_of_mass(self) -> None:
        """Draws a bar through the centre of mass, which itself is hidden inside the body."""
        columns = self._rollout.columns
        self._bars("world/com/actual", columns.com_pos_w, colours.COM)
        target, known = columns.com_pos_w.copy(), np.isfinite(columns.com_height_target)
        target[:, 2] += columns.com_height_target - columns.com_height
        if known.any():
            self._bars("world/com/target", target, colours.TARGET, known)

    def _bars(self, path: str, centres: Array, colour: Colour, there: Mask | None = None) -> None:
        """Draws level bars across the robot at `centres` [T, 3]."""
        columns = self._rollout.columns
        level = np.broadcast_to(np.array((0.0, 0.0, 1.0), np.float32), centres.shape)
        across = HALF_BAR * _along(level, columns.root_quat_w)[1]
        self._lines(path, np.stack([centres - across, centres + across], axis=1), colour, 0.012, there)

    def _log_ground_normal(self) -> None:
        columns = self._rollout.columns
        below = columns.root_pos_w.copy()
        below[:, 2] -= columns.root_height
        self._arrows("world/ground_normal", below, 0.5 * columns.ground_normal_w, colours.NORMAL)

    def _log_events(self) -> None:
        events = self._rollout.events
        if not events:
            return
        seconds = [event.time for event in events]
        steps = np.rint(np.array(seconds) / self._rollout.header["dt"]).astype(np.int64)
        times = [rr.TimeColumn(TIME, duration=seconds), rr.TimeColumn(STEP, sequence=steps)]
        levels = ["WARN" if event.kind in ("fall", "cause", "push", "touch") else "INFO" for event in events]
        texts = [event.text for event in events]
        self._recording.send_columns(self._prefix + "events", times, rr.TextLog.columns(text=texts, level=levels))

    def _log_failures(self) -> None:
        """Marks the places where a fall began and where it ended, with what happened there, for `MARKED_S`."""
        columns, dt = self._rollout.columns, self._rollout.header["dt"]
        for kind, colour in (("cause", colours.COMMANDED), ("fall", colours.ZMP)):
            failures = [event for event in self._rollout.events if event.kind == kind]
            if not failures:
                continue
            rows = np.clip(np.searchsorted(columns.time, [e.time - 0.5 * dt for e in failures]), 0, len(columns) - 1)
            places = columns.root_pos_w[rows] + np.array((0.0, 0.0, MARK_HEIGHT), np.float32)
            # A mark stays until the next one: a second, empty one ends it.
            begin = columns.time[rows].astype(np.float64)
            end = np.minimum(begin + MARKED_S, np.append(begin[1:] - 1e-3, np.inf))
            moments = np.stack([begin, end], axis=1).ravel()
            there = np.tile([1, 0], len(rows)).astype(np.int32)
            within = (there == 1) | (moments < columns.time[-1])  # nothing comes after the end of the walk
            moments, there = moments[within], there[within]
            steps = np.rint(moments / dt).astype(np.int64)
            times = [rr.TimeColumn(TIME, duration=moments), rr.TimeColumn(STEP, sequence=steps)]
            path = f"{self._prefix}world/failure/{kind}"
            self._static(
                f"world/failure/{kind}", rr.Points3D.from_fields(colors=[colour], radii=[0.05], show_labels=True)
            )
            marks = rr.Points3D.columns(positions=places, labels=[e.text for e in failures]).partition(there)
            self._recording.send_columns(path, times, marks)

    def log_about(self, text: str) -> None:
        """Writes the origin of the walk, a text in Markdown."""
        self._static("about", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))

    def series(
        self, path: str, values: Array, names: Sequence[str], palette: Sequence[Colour], width: float = 1.5
    ) -> None:
        """Writes `values` [T, K] as K lines of one plot."""
        lines = rr.SeriesLines(names=list(names), colors=list(palette), widths=[width] * len(names))
        self._static(path, lines)
        flat = rr.Scalars.columns(scalars=np.ascontiguousarray(values, np.float64).ravel())
        self._columns(path, flat.partition([len(names)] * len(values)))

    def _static(self, path: str, what: rr.AsComponents) -> None:
        self._recording.log(self._prefix + path, what, static=True)

    def _columns(self, path: str, columns: Iterable[rr.ComponentColumn]) -> None:
        self._recording.send_columns(self._prefix + path, self._times, columns)

    def _moves(self, path: str, position: Array, rotation: Array) -> None:
        quaternion = Rotation.from_matrix(rotation).as_quat()  # (x, y, z, w), as rerun has it too
        where = rr.Transform3D.columns(
            translation=position.astype(np.float32), quaternion=quaternion.astype(np.float32)
        )
        self._columns(path, where)

    def _arrows(self, path: str, origins: Array, vectors: Array, colour: Colour) -> None:
        self._static(path, rr.Arrows3D.from_fields(colors=[colour], radii=[0.012]))
        self._columns(path, rr.Arrows3D.columns(origins=origins, vectors=vectors))

    def _points(self, path: str, places: Array, colour: Colour, radius: float, there: Mask | None = None) -> None:
        """Draws points at `places` [T, 3] at the steps where `there` [T] is true."""
        shown = np.ones(len(places), bool) if there is None else there
        self._static(path, rr.Points3D.from_fields(colors=[colour], radii=[radius]))
        self._columns(path, rr.Points3D.columns(positions=places[shown]).partition(shown.astype(np.int32)))

    def _lines(self, path: str, ends: Array, colour: Colour, radius: float, there: Mask | None = None) -> None:
        """Draws lines between `ends` [T, 2, 3] at the steps where `there` [T] is true."""
        shown = np.ones(len(ends), bool) if there is None else there
        self._static(path, rr.LineStrips3D.from_fields(colors=[colour], radii=[radius]))
        self._columns(path, rr.LineStrips3D.columns(strips=ends[shown]).partition(shown.astype(np.int32)))


def mesh(shape: Shape) -> rr.Mesh3D:
    """A shape as rerun draws it."""
    return rr.Mesh3D(
        vertex_positions=shape.vertices,
        vertex_normals=shape.normals,
        triangle_indices=shape.triangles,
        vertex_colors=shape.colours,
    )


def _along(normal: Array, root_quat: Array) -> tuple[Array, Array, Array]:
    """Returns unit vectors [T, 3] of planes with these normals: along the heading, to the left, out of the plane."""
    heading = rotation.yaw(root_quat.astype(np.float64))
    level = np.stack([np.cos(heading), np.sin(heading), np.zeros_like(heading)], axis=1)
    left = np.cross(normal, level)
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    return np.cross(left, normal), left, normal
