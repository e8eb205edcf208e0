"""The ray tracer against geometry that can be worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import trimesh

from humoslope.replay.film import raytrace
from humoslope.replay.film.raytrace import Camera, Solid, render
from humoslope.replay.rollout import Rollout
from humoslope.replay.shapes import Shape, chequers, ground_shape, joined
from humoslope.terrain import TerrainQueries
from humoslope.terrain.grid import Terrain

SIZE = 101


def ball(centre: tuple[float, float, float], radius: float, colour: tuple[int, int, int] = (200, 200, 200)) -> Shape:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return Shape(
        vertices=(mesh.vertices + centre).astype(np.float32),
        normals=(mesh.vertices / radius).astype(np.float32),
        triangles=mesh.faces.astype(np.int32),
        colours=np.tile(np.array(colour, np.uint8), (len(mesh.vertices), 1)),
    )


def floor(half: float = 20.0, grey: int = 128) -> Shape:
    return Shape(
        vertices=np.array([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)], np.float32),
        normals=np.tile(np.array((0, 0, 1), np.float32), (4, 1)),
        triangles=np.array([(0, 1, 2), (0, 2, 3)], np.int32),
        colours=np.full((4, 3), grey, np.uint8),
    )


def camera(eye: tuple[float, float, float], target: tuple[float, float, float], degrees: float = 40.0) -> Camera:
    return Camera(np.array(eye, np.float32), np.array(target, np.float32), SIZE, SIZE, math.radians(degrees))


def test_the_middle_of_the_picture_is_what_the_camera_looks_at_and_its_edge_half_the_view_away() -> None:
    eye, target = np.array((1.0, -4.0, 2.0)), np.array((0.5, 0.3, -0.2))
    rays = camera(tuple(eye), tuple(target)).rays(
        np.array([SIZE / 2] * 2, np.float32), np.array([SIZE / 2, 0], np.float32)
    )
    np.testing.assert_allclose(rays[0], (target - eye) / np.linalg.norm(target - eye), atol=1e-6)
    assert math.degrees(math.acos(rays[0] @ rays[1])) == pytest.approx(20.0, abs=0.01)
    assert rays[1][2] > rays[0][2]  # the first row is the upper one


def test_a_ball_is_as_large_in_the_picture_as_its_angle_says() -> None:
    radius, distance = 0.5, 4.0
    picture = render(camera((0, -distance, 0), (0, 0, 0)), [Solid(ball((0, 0, 0), radius))])
    sky = render(camera((0, -distance, 0), (0, 0, 0)), [Solid(ball((0, 50, 0), radius))])
    covered = (np.abs(picture.astype(int) - sky).sum(axis=2) > 0).sum()
    per_radian = 0.5 * SIZE / math.tan(math.radians(20.0))
    expected = math.pi * (per_radian * math.tan(math.asin(radius / distance))) ** 2
    assert covered == pytest.approx(expected, rel=0.06)  # with the pixels that it covers in part


def test_light_on_level_ground_is_that_of_the_sun_by_its_height_and_of_the_sky() -> None:
    picture = render(camera((0, -0.01, 0.2), (0, 0, 0)), [Solid(floor())])
    albedo = (128 / 255) ** raytrace.GAMMA
    light = albedo * (raytrace.SUNLIGHT * raytrace.SUN[2] + raytrace.SKYLIGHT)
    expected = 255 * np.clip(light, 0, 1) ** (1 / raytrace.GAMMA)
    np.testing.assert_allclose(picture[SIZE // 2, SIZE // 2], expected, atol=2.0)  # and a touch of haze


def test_a_ball_throws_its_shadow_away_from_the_sun() -> None:
    height = 2.0
    shadow = -raytrace.SUN[:2] / raytrace.SUN[2] * height
    things = [Solid(floor()), Solid(ball((0, 0, height), 0.3))]

    def brightness(x: float, y: float) -> float:
        below = camera((x, y - 0.01, 0.5), (x, y, 0.0), 5.0)
        return float(render(below, things)[SIZE // 2, SIZE // 2].mean())

    assert brightness(*shadow) < 0.75 * brightness(*(-shadow))
    assert brightness(*(shadow + 0.6)) == pytest.approx(brightness(*(-shadow)), abs=1.0)


def test_what_is_nearer_hides_what_is_behind_it() -> None:
    red, blue = Solid(ball((0, 0, 0), 0.4, (255, 0, 0))), Solid(ball((0, 1.5, 0), 0.4, (0, 0, 255)))
    for things in ([red, blue], [blue, red]):
        r, _, b = render(camera((0, -3, 0), (0, 0, 0)), things)[SIZE // 2, SIZE // 2]
        assert r > 2 * b


def test_edges_are_mixed_and_the_inside_is_not() -> None:
    picture = render(camera((0, -4, 0), (0, 0, 0)), [Solid(ball((0, 0, 0), 0.5, (0, 0, 0)))])
    row = picture[SIZE // 2].sum(axis=1).astype(int)
    assert len(np.unique(row[SIZE // 2 - 3 : SIZE // 2 + 3])) < 4
    assert np.isin(row, range(120, 500)).any()  # between black and the sky


def test_shapes_are_joined_and_moved_as_wholes() -> None:
    first, second = ball((0, 0, 0), 1.0), ball((0, 0, 0), 2.0)
    turn = trimesh.transformations.rotation_matrix(0.7, (1, 2, 3))[:3, :3]
    both = joined([first, second.moved(turn, np.array((5.0, 0.0, 0.0)))])
    corners = both.vertices[both.triangles[len(first.triangles) :]].reshape(-1, 3)
    np.testing.assert_allclose(np.linalg.norm(corners - (5.0, 0.0, 0.0), axis=1), 2.0, atol=1e-5)
    np.testing.assert_allclose(both.normals[len(first.vertices) :], second.normals @ turn.T, atol=1e-6)


def test_the_drawn_ground_is_as_high_as_the_one_that_is_walked_on(rollout: Rollout) -> None:
    header, heights = rollout.header["terrain"], rollout.terrain_heights
    terrain = Terrain(
        heights, header["cell"], tuple(header["origin"]), np.zeros((1, 1, 3)), ("",), np.zeros((1, 1)), 1, 1
    )
    rng = np.random.default_rng(0)
    x0, y0 = header["tile_origin"][:2]
    x = x0 + rng.uniform(0.0, header["tile_length"], 500)
    y = y0 + header["tile_width"] * rng.uniform(-0.5, 0.5, 500)
    above = np.stack([x, y, np.full(500, 30.0)], axis=1).astype(np.float32)
    down = np.tile(np.array((0, 0, -1), np.float32), (500, 1))
    distance, *_ = Solid(ground_shape(rollout)).meet(above, down)
    expected = TerrainQueries(terrain, "cpu").height(torch.from_numpy(above[:, :2]))
    np.testing.assert_allclose(30.0 - distance, expected, atol=1e-4)


def test_the_drawn_ground_is_a_slab_without_the_border(rollout: Rollout) -> None:
    header, shape = rollout.header["terrain"], ground_shape(rollout)
    assert np.ptp(shape.vertices[:, 0]) == pytest.approx(header["tile_length"], abs=1e-4)
    assert np.ptp(shape.vertices[:, 1]) == pytest.approx(header["tile_width"], abs=1e-4)
    # Seen from outside, every wall is in the way.
    middle = shape.vertices.mean(axis=0)
    for side in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        outward = np.array((*side, 0), np.float32)
        x, y = middle[:2] + 50.0 * outward[:2]
        edge = shape.vertices[np.argmax(shape.vertices @ outward)]
        start = np.array([[x if side[0] else edge[0], y if side[1] else edge[1], edge[2] - 0.25]], np.float32)
        distance, triangle, *_ = Solid(shape).meet(start, -outward[None])
        assert distance[0] < 50.0
        assert shape.normals[shape.triangles[triangle[0], 0]] @ outward > 0.99


def test_chequers_change_every_metre() -> None:
    at = np.array([0.5, 1.5, 2.5])
    first, second, third = chequers(at, np.full(3, 0.5))
    assert (first == third).all()
    assert (first != second).any()
    assert (chequers(np.array(0.5), np.array(-0.5)) == second).all()
