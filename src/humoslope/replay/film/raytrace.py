"""Ray tracer on the CPU with Embree: pictures without a display, a GPU or a graphics driver.

The light is a sun with sharp shadows, and a sky that lights from above. Colours are mixed linearly and written as sRGB.
"""

from __future__ import annotations

import functools
import platform
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from humoslope.errors import UserError
from humoslope.replay.shapes import Shape

try:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene
except ModuleNotFoundError:
    if platform.machine() != "aarch64":
        raise
    raise UserError("video needs the package embreex, which is not available for this machine.") from None

Array = NDArray[np.float32]
Picture = NDArray[np.uint8]

SUN = np.array((0.35, -0.5, 0.8), np.float32) / np.linalg.norm((0.35, -0.5, 0.8)).astype(np.float32)
"""Direction towards the sun: on the camera's side, so that the lit side is visible."""
SUNLIGHT = np.array((1.05, 1.0, 0.92), np.float32)
SKYLIGHT = np.array((0.42, 0.46, 0.52), np.float32)
ZENITH = np.array((0.30, 0.50, 0.78), np.float32)
HORIZON = np.array((0.86, 0.91, 0.95), np.float32)
HAZE = 60.0
"""Distance over which colours fade into the horizon, m."""
LIFT = 2e-3
"""Height above a surface at which its shadow rays start, m, so that they do not hit the surface itself."""
GAMMA = 2.2
SUBPIXELS = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))
"""Offsets in a pixel at which pixels on an edge are traced again."""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera without roll.

    Attributes:
        eye: [3] position, m.
        target: [3] point in the centre of the picture, m.
        width: Width of the picture, pixels.
        height: Height of the picture, pixels.
        view: Vertical field of view, rad.
    """

    eye: Array
    target: Array
    width: int
    height: int
    view: float

    def rays(self, column: Array, row: Array) -> Array:
        """Returns unit directions [P, 3] through points [P] of the picture, in pixels from its upper left corner."""
        forward = (self.target - self.eye) / np.linalg.norm(self.target - self.eye)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        up = np.cross(right, forward)
        scale = 2.0 * np.tan(0.5 * self.view) / self.height
        x, y = scale * (column - 0.5 * self.width), scale * (0.5 * self.height - row)
        rays = np.stack([np.ones_like(x), x, y], axis=1) @ np.stack([forward, right, up]).astype(np.float32)
        return _unit(rays.astype(np.float32))


class Solid:
    """A shape in the world that rays can hit."""

    def __init__(self, shape: Shape) -> None:
        self._shape = shape
        self._colours: Array = (shape.colours.astype(np.float32) / 255.0) ** np.float32(GAMMA)
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, np.ascontiguousarray(shape.vertices), np.ascontiguousarray(shape.triangles))
        low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
        self._centre, self._radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))

    def meet(self, origins: Array, rays: Array) -> tuple[Array, NDArray[np.int32], Array, Array]:
        """Returns the first hit of each ray [P, 3]: distance [P] (infinite for none), triangle [P] (-1 for none), and
        the two coordinates [P] in the triangle."""
        distance = np.full(len(rays), np.inf, np.float32)
        triangle = np.full(len(rays), -1, np.int32)
        u, v = np.zeros_like(distance), np.zeros_like(distance)
        near = self._near(origins, rays)
        if len(near):
            met = self._scene.run(origins[near], rays[near], output=True)
            triangle[near], u[near], v[near] = met["primID"], met["u"], met["v"]
            distance[near] = np.where(met["primID"] >= 0, met["tfar"], np.inf)
        return distance, triangle, u, v

    def shades(self, origins: Array) -> NDArray[np.bool_]:
        """Returns for each point [P, 3] whether the shape is between it and the sun."""
        rays = np.broadcast_to(SUN, origins.shape)
        dark, near = np.zeros(len(origins), bool), self._near(origins, rays)
        if len(near):
            dark[near] = self._scene.run(origins[near], rays[near], query="OCCLUDED") >= 0
        return dark

    def _near(self, origins: Array, rays: Array) -> NDArray[np.int64]:
        """Returns the indices of the rays that cross the bounding sphere; most do not come near a robot."""
        to_centre = self._centre - origins
        along = np.einsum("ij,ij->i", to_centre, rays)
        return np.flatnonzero(np.einsum("ij,ij->i", to_centre, to_centre) - along**2 < self._radius**2)

    def surface(self, triangle: NDArray[np.int32], u: Array, v: Array) -> tuple[Array, Array]:
        """Returns, for points in triangles, the interpolated normal [P, 3] and the colour of the first corner."""
        corners = self._shape.triangles[triangle]
        first, second, third = (self._shape.normals[corners[:, i]] for i in range(3))
        u, v = u[:, None], v[:, None]
        return _unit(first * (1.0 - u - v) + second * u + third * v), self._colours[corners[:, 0]]


def render(camera: Camera, solids: list[Solid]) -> Picture:
    """Returns the picture of the camera, [height, width, 3]."""
    rows, columns = np.indices((camera.height, camera.width), dtype=np.float32).reshape(2, -1) + np.float32(0.5)
    colour, kind = _trace(camera, solids, columns, rows)
    edges = np.flatnonzero(_edges(kind.reshape(camera.height, camera.width), colour))
    finer = [_trace(camera, solids, columns[edges] + dx, rows[edges] + dy)[0] for dx, dy in SUBPIXELS]
    colour[edges] = np.mean(finer, axis=0)
    encoded = 255.0 * np.clip(colour, 0.0, 1.0) ** (1.0 / GAMMA)
    return np.rint(encoded).astype(np.uint8).reshape(camera.height, camera.width, 3)


def _trace(camera: Camera, solids: list[Solid], column: Array, row: Array) -> tuple[Array, NDArray[np.int32]]:
    """Returns the linear colour [P, 3] and the index of the visible solid [P], -1 for the sky."""
    rays = camera.rays(column, row)
    origins = np.broadcast_to(camera.eye.astype(np.float32), rays.shape).copy()
    met = [solid.meet(origins, rays) for solid in solids]
    nearest = functools.reduce(np.minimum, [distance for distance, *_ in met])
    colour = HORIZON + (ZENITH - HORIZON) * np.clip(1.6 * rays[:, 2:], 0.0, 1.0)
    seen = np.full(len(rays), -1, np.int32)
    for number, (solid, (distance, triangle, u, v)) in enumerate(zip(solids, met, strict=True)):
        here = np.flatnonzero((distance == nearest) & np.isfinite(distance))
        if not len(here):
            continue
        normal, albedo = solid.surface(triangle[here], u[here], v[here])
        place = origins[here] + distance[here, None] * rays[here] + LIFT * normal
        light = normal @ SUN
        lit = np.flatnonzero(light > 0.0)
        dark = functools.reduce(np.logical_or, [other.shades(place[lit]) for other in solids])
        light[lit[dark]] = 0.0
        shaded = albedo * (SUNLIGHT * np.maximum(light, 0.0)[:, None] + SKYLIGHT * (0.6 + 0.4 * normal[:, 2:]))
        haze = 1.0 - np.exp(-distance[here, None] / HAZE)
        colour[here] = shaded + haze * (HORIZON - shaded)
        seen[here] = number
    return colour.astype(np.float32), seen


def _unit(vectors: Array) -> Array:
    """Returns vectors [P, 3] scaled to length 1."""
    unit: Array = vectors / np.sqrt(np.einsum("ij,ij->i", vectors, vectors))[:, None]
    return unit


def _edges(kind: NDArray[np.int32], colour: Array) -> NDArray[np.bool_]:
    """Returns a mask [height, width] of pixels that differ from a neighbour so much that they would look jagged."""
    brightness = (colour @ np.full(3, 1.0 / 3.0, np.float32)).reshape(kind.shape)
    edges = np.zeros(kind.shape, bool)
    for axis in (0, 1):
        step = (np.diff(kind, axis=axis) != 0) | (np.abs(np.diff(brightness, axis=axis)) > 0.06)
        padding = [(0, 0), (0, 0)]
        padding[axis] = (1, 1)
        step = np.pad(step, padding)
        edges |= step.take(range(kind.shape[axis]), axis) | step.take(range(1, kind.shape[axis] + 1), axis)
    return edges
