"""A picture of a walk without a display, a graphics driver or an extra: MuJoCo's ray casting, and a low sun."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from humoslope.deploy.player import Player
from humoslope.deploy.quantities import Array
from humoslope.files import write_atomically

WIDTH, HEIGHT, FINER = 800, 450, 2
"""Size of the picture, pixels, and rays along each side of a pixel."""
VIEW = math.radians(34.0)
"""Vertical field of view, rad."""
EYE = np.array([0.6, -6.2, 1.3])
"""Place of the camera relative to the middle of the walk, m: on the right of the robot."""
SUN = np.array([-60.0, -80.0, 110.0])
"""Place of the sun relative to the middle of the walk, m."""
DARKEST = 0.45
"""Brightness of what the sun does not reach."""
SKY_LOW, SKY_HIGH = np.array([0.90, 0.94, 0.97]), np.array([0.45, 0.64, 0.86])
TILE_M = 0.5
DARK_TILE, LIGHT_TILE = np.array([0.56, 0.60, 0.55]), np.array([0.64, 0.68, 0.62])
HAZE_M = 60.0
"""Distance over which the ground fades into the sky, m."""
GROUPS = np.array([1, 1, 1, 0, 0, 0], np.uint8)
"""Groups of geoms that are drawn; the others are for contacts."""
SHADOW_SLACK_M = 0.01


def draw_walk(player: Player, seconds: float, poses: int, caption: str, path: Path) -> bool:
    """Lets the robot walk along its course and draws it at several moments in one picture, written as PNG.

    Args:
        player: The policy and its robot.
        seconds: Length of the walk, s.
        poses: Number of moments, evenly spread, with start and end.
        caption: A line in the upper left corner.
        path: The picture.

    Returns:
        Whether the robot was still walking at the end; if not, the picture ends with its fall.
    """
    world, steps = player.world, round(seconds / player.contract.timing.control_step_s)
    drawn = set(np.linspace(0, steps, poses).round().astype(int))
    player.start()
    states, stood = [world.data.qpos.copy()], True
    for step in range(1, steps + 1):
        player.step(player.course_command())
        stood = not world.fallen()
        if step in drawn or not stood:
            states.append(world.data.qpos.copy())
        if not stood:
            break
    write_atomically(path, lambda temporary: _drawn(player, states, caption).save(temporary, format="PNG"))
    return stood


def _drawn(player: Player, states: list[Array], caption: str) -> Image.Image:
    world = player.world
    model, data = world.model, mujoco.MjData(world.model)
    first, last = (state[world.free_pos : world.free_pos + 3] for state in (states[0], states[-1]))
    middle = 0.5 * (first + last)
    away = max(1.0, float(np.linalg.norm(last - first)) / 4.0)
    eye, size = middle + away * EYE, (FINER * WIDTH, FINER * HEIGHT)
    rays = _rays(middle - eye, *size)
    scene = _Nearest(len(rays))
    for state in states:
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        scene.add(model, data, eye, rays)
    colour = scene.colours(model, eye, rays)
    sun, hit = middle + SUN, np.isfinite(scene.distance)
    places = eye + scene.distance[hit, None] * rays[hit]
    to_places = places - sun
    far = np.linalg.norm(to_places, axis=1)
    shade = _Nearest(len(places))
    for state in states:
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        shade.add(model, data, sun, to_places / far[:, None])
    lit = shade.distance > far - SHADOW_SLACK_M
    facing = np.clip(-np.einsum("ij,ij->i", scene.normal[hit], to_places) / far, 0.0, 1.0)
    haze = np.exp(-scene.distance[hit, None] / HAZE_M)
    light = DARKEST + (1.0 - DARKEST) * np.where(lit, facing, 0.0)
    colour[hit] = haze * colour[hit] * light[:, None] + (1.0 - haze) * SKY_LOW
    pixels = colour.reshape(HEIGHT, FINER, WIDTH, FINER, 3).mean(axis=(1, 3))
    image = Image.fromarray(np.rint(255.0 * np.clip(pixels, 0.0, 1.0)).astype(np.uint8))
    ImageDraw.Draw(image).text((18, 14), caption, (38, 44, 52), ImageFont.load_default(20))
    return image


class _Nearest:
    """The first hit of each ray, over several poses of one robot.

    Attributes:
        distance: [R] m; infinite for none.
        normal: [R, 3] of the surface.
        geom: [R] geom that was hit; -1 for none.
    """

    def __init__(self, rays: int) -> None:
        self.distance = np.full(rays, np.inf)
        self.normal = np.zeros((rays, 3))
        self.geom = np.full(rays, -1, np.int32)

    def add(self, model: mujoco.MjModel, data: mujoco.MjData, origin: Array, rays: Array) -> None:
        """Takes in a pose."""
        count = len(rays)
        geom, distance, normal = np.full(count, -1, np.int32), np.zeros(count), np.zeros(3 * count)
        mujoco.mj_multiRay(
            model, data, origin, rays.ravel(), GROUPS, True, -1, geom, distance, normal, count, mujoco.mjMAXVAL
        )
        nearer = (geom >= 0) & (distance < self.distance)
        self.geom[nearer], self.distance[nearer] = geom[nearer], distance[nearer]
        self.normal[nearer] = normal.reshape(-1, 3)[nearer]

    def colours(self, model: mujoco.MjModel, eye: Array, rays: Array) -> NDArray[np.float64]:
        """Colours [R, 3] without light: the geoms' own, tiles on the ground, and the sky."""
        up = np.clip(3.0 * rays[:, 2:], 0.0, 1.0)
        colour = SKY_LOW + up * (SKY_HIGH - SKY_LOW)
        robot = (self.geom >= 0) & (model.geom_bodyid[self.geom] > 0)
        colour[robot] = model.geom_rgba[self.geom[robot], :3]
        ground = (self.geom >= 0) & ~robot
        places = eye + self.distance[ground, None] * rays[ground]
        # Along the slope, so that tiles are squares on it.
        normal = self.normal[ground]
        along = places[:, 0] / np.maximum(normal[:, 2], 0.1)
        across = places[:, 1] / np.maximum(np.hypot(normal[:, 0], normal[:, 2]), 0.1)
        odd = (np.floor(along / TILE_M) + np.floor(across / TILE_M)) % 2 == 1
        colour[ground] = np.where(odd[:, None], DARK_TILE, LIGHT_TILE)
        return colour


def _rays(forward: Array, width: int, height: int) -> NDArray[np.float64]:
    """Unit directions [R, 3] through the pixels of a camera without roll that looks forward, row by row."""
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    up, scale = np.cross(right, forward), 2.0 * math.tan(0.5 * VIEW) / height
    row, column = np.indices((height, width)).reshape(2, -1) + 0.5
    x, y = scale * (column - 0.5 * width), scale * (0.5 * height - row)
    rays = forward + x[:, None] * right + y[:, None] * up
    unit: NDArray[np.float64] = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return unit
