"""Pictures of a rollout: the robot on its ground, from its right side, with a caption."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from humoslope.replay.film.follow import follow
from humoslope.replay.film.raytrace import Camera, Picture, Solid, render
from humoslope.replay.robot import RobotShape
from humoslope.replay.rollout import Rollout
from humoslope.replay.shapes import Shape, ground_shape, joined

EYE = np.array((0.75, -3.2, 0.5), np.float32)
"""Position of the camera relative to the robot, m: on its right, a little ahead and above."""
TARGET = np.array((0.15, 0.0, -0.08), np.float32)
"""Centre of the picture relative to the robot, m."""
VIEW = math.radians(36.0)
EVENT_S = 1.5
"""Time for which an event is shown, s."""
INK, FAINT, ALARM = (38, 44, 52), (92, 100, 110), (183, 28, 28)


class Frames:
    """Draws a rollout at any of its steps.

    Args:
        rollout: The rollout.
        width: Width of the pictures, pixels.
        height: Height of the pictures, pixels.
        meshes: Shape of each link, as in `RobotShape`.
    """

    def __init__(self, rollout: Rollout, width: int, height: int, meshes: Mapping[str, Shape] | None = None) -> None:
        self._rollout, self._width, self._height = rollout, width, height
        self._robot = RobotShape(rollout.header["robot"]["urdf"], meshes)
        self._poses = self._robot.poses(rollout)
        self._ground = Solid(ground_shape(rollout))
        self._middle = follow(rollout.columns, rollout.header["dt"])
        self._large, self._small = (ImageFont.truetype(_font(), round(height * size)) for size in (0.038, 0.031))

    def __call__(self, step: int) -> Picture:
        """The picture [height, width, 3] of a step."""
        parts = []
        for link, shape in self._robot.shapes.items():
            poses = self._poses[link]
            parts.append(shape.moved(poses.rotation[step], poses.position[step]))
        middle = self._middle[step]
        camera = Camera(middle + EYE, middle + TARGET, self._width, self._height, VIEW)
        return self._caption(render(camera, [self._ground, Solid(joined(parts))]), step)

    def _caption(self, picture: Picture, step: int) -> Picture:
        image = Image.fromarray(picture)
        draw = ImageDraw.Draw(image)
        columns, header = self._rollout.columns, self._rollout.header
        time, margin = float(columns.time[step]), round(0.035 * self._height)
        terrain = header["terrain"]
        draw.text(
            (margin, margin), f"{header['label']}   {terrain['name']} {terrain['grade']:g}°", font=self._large, fill=INK
        )
        below = margin + round(0.055 * self._height)
        told = f"{time:.1f} s   {columns.root_lin_vel_t[step, 0]:.2f} m/s of {columns.command[step, 0]:.2f} asked   "
        draw.text(
            (margin, below),
            f"{told}ground {round(math.degrees(columns.slope[step])):+d}°",
            font=self._small,
            fill=FAINT,
        )
        recent = [event for event in self._rollout.events if 0.0 <= time - event.time < EVENT_S]
        for line, event in enumerate(recent):
            place = (margin, below + (line + 1) * round(0.05 * self._height))
            fill = ALARM if event.kind in ("fall", "cause", "push") else FAINT
            draw.text(place, event.text, font=self._small, fill=fill)
        return np.asarray(image)


def _font() -> str:
    """Path of matplotlib's font, which is there where none is installed; found without the time to import all of it."""
    found = find_spec("matplotlib")
    assert found is not None
    assert found.origin is not None
    return str(Path(found.origin).parent / "mpl-data" / "fonts" / "ttf" / "DejaVuSans.ttf")
