"""The terrain-aligned zero-moment point of the paper's section 3.1."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humoslope.slope import zmp

LEAST = 2.0  # m/s^2, as the regulariser has it
UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)

slopes = st.floats(-45.0, 45.0)
headings = st.floats(-180.0, 180.0)
seeds = st.integers(0, 2**32 - 1)


def incline(slope: float, heading: float) -> Rotation:
    """Turns level ground into a plane that rises by `slope` degrees towards `heading` degrees."""
    return Rotation.from_euler("ZY", [heading, -slope], degrees=True)


def tensor(x: object) -> torch.Tensor:
    return torch.as_tensor(np.asarray(x), dtype=torch.float64)


def zmp_deviation(com, acc, anchor, normal, least):
    """Distance of the zero-moment point from the anchor, and whether the point is defined."""
    point, valid = zmp.zero_moment_point(com, acc, anchor, normal, least)
    return (point - anchor).norm(dim=-1), valid


@given(slope=slopes, heading=headings, seed=seeds)
def test_zmp_of_a_still_robot_lies_below_its_com_along_gravity_on_any_incline(slope, heading, seed):
    rng = np.random.default_rng(seed)
    normal = tensor(incline(slope, heading).apply([0.0, 0.0, 1.0]))
    anchor = tensor(rng.uniform(-5.0, 5.0, 3))
    com = anchor + 0.7 * UP + tensor([*rng.uniform(-0.2, 0.2, 2), 0.0])
    point = zmp.zmp_on_plane(com, zmp.apparent_force(torch.zeros_like(com)), anchor, normal)
    torch.testing.assert_close(point[:2], com[:2])
    assert (point - anchor) @ normal == pytest.approx(0.0, abs=1e-9)


@given(slope=slopes, heading=headings, height=st.floats(0.3, 1.5))
def test_a_still_robot_right_above_its_anchor_deviates_by_nothing_on_any_incline(slope, heading, height):
    normal = tensor(incline(slope, heading).apply([0.0, 0.0, 1.0]))
    anchor = tensor([1.0, -2.0, 0.3])
    deviation, valid = zmp_deviation(anchor + height * UP, torch.zeros_like(anchor), anchor, normal, LEAST)
    assert valid
    assert deviation == pytest.approx(0.0, abs=1e-9)


def test_on_a_slope_of_thirty_degrees_a_push_uphill_moves_the_zmp_downhill_as_by_hand():
    # The plane rises towards +x with tan 30 = 1/sqrt(3); the CoM is 0.8 m above its foot point. The ray leaves it along
    # (-a, 0, -g), so x = -a t and z = 0.8 - g t meet on z = x / sqrt(3) at t = 0.8 / (g - a / sqrt(3)).
    normal = tensor([-math.sin(math.radians(30.0)), 0.0, math.cos(math.radians(30.0))])
    com, anchor = tensor([0.0, 0.0, 0.8]), tensor([0.0, 0.0, 0.0])
    acc = tensor([2.0, 0.0, 0.0])
    t = 0.8 / (9.81 - 2.0 / math.sqrt(3.0))
    point = zmp.zmp_on_plane(com, zmp.apparent_force(acc), anchor, normal)
    torch.testing.assert_close(point, tensor([-2.0 * t, 0.0, 0.8 - 9.81 * t]))
    deviation, valid = zmp_deviation(com, acc, anchor, normal, LEAST)
    assert valid
    assert deviation == pytest.approx(2.0 * t / math.cos(math.radians(30.0)))
    # Measured on the horizontal through the anchor it would be z = 0 at t = 0.8 / g: a sixth less.
    horizontal, _ = zmp_deviation(com, acc, anchor, UP, LEAST)
    assert horizontal == pytest.approx(2.0 * 0.8 / 9.81)


@given(slope=slopes, heading=headings, seed=seeds)
def test_the_deviation_is_that_of_the_papers_formulas_written_in_numpy(slope, heading, seed):
    rng = np.random.default_rng(seed)
    n = incline(slope, heading).apply([0.0, 0.0, 1.0])
    feet, force = rng.normal(0.0, 0.2, (2, 3)), rng.uniform(0.0, 400.0, 2)
    com, acc = np.array([*rng.normal(0.0, 0.1, 2), 0.7]), rng.normal(0.0, 1.5, 3)
    p_sa = ((force[0] + 1.0) * feet[0] + (force[1] + 1.0) * feet[1]) / (force[0] + force[1] + 2.0)
    f_app = np.array([0.0, 0.0, -9.81]) - acc
    assume(f_app @ n <= -LEAST)
    t = (p_sa - com) @ n / (f_app @ n)
    expected = np.linalg.norm(com + t * f_app - p_sa)

    anchor = zmp.support_anchor(tensor(feet), tensor(force), 1.0)
    deviation, valid = zmp_deviation(tensor(com), tensor(acc), anchor, tensor(n), LEAST)
    np.testing.assert_allclose(anchor, p_sa, atol=1e-12)
    assert valid
    assert deviation == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(slope=slopes, heading=headings, seed=seeds)
def test_the_zmp_lies_in_the_plane_so_its_deviation_is_a_distance_along_the_ground(slope, heading, seed):
    rng = np.random.default_rng(seed)
    frame = incline(slope, heading)
    n = tensor(frame.apply([0.0, 0.0, 1.0]))
    anchor = tensor(rng.uniform(-1.0, 1.0, 3))
    com = anchor + 0.7 * UP + tensor([*rng.normal(0.0, 0.1, 2), 0.0])
    acc = tensor(rng.normal(0.0, 1.0, 3))
    offset = zmp.zmp_on_plane(com, zmp.apparent_force(acc), anchor, n) - anchor
    along, across = (offset @ tensor(frame.apply(axis)) for axis in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    deviation, valid = zmp_deviation(com, acc, anchor, n, LEAST)
    assert valid
    assert offset @ n == pytest.approx(0.0, abs=1e-9)
    assert deviation == pytest.approx(math.hypot(along, across), abs=1e-9)


@given(slope=slopes, yaw=headings, seed=seeds)
def test_turning_and_moving_the_world_moves_the_zmp_along_and_leaves_the_deviation(slope, yaw, seed):
    rng = np.random.default_rng(seed)
    turn, shift = Rotation.from_euler("z", yaw, degrees=True), rng.uniform(-50.0, 50.0, 3)
    n = incline(slope, 20.0).apply([0.0, 0.0, 1.0])
    anchor, com, acc = np.array([0.1, 0.2, 0.0]), np.array([0.0, 0.1, 0.75]), rng.normal(0.0, 1.0, 3)

    def moved(point: np.ndarray) -> torch.Tensor:
        return tensor(turn.apply(point) + shift)

    here = zmp.zmp_on_plane(tensor(com), zmp.apparent_force(tensor(acc)), tensor(anchor), tensor(n))
    acc_there, n_there = tensor(turn.apply(acc)), tensor(turn.apply(n))
    there = zmp.zmp_on_plane(moved(com), zmp.apparent_force(acc_there), moved(anchor), n_there)
    torch.testing.assert_close(there, moved(here.numpy()), rtol=0, atol=1e-9)
    before, _ = zmp_deviation(tensor(com), tensor(acc), tensor(anchor), tensor(n), LEAST)
    after, _ = zmp_deviation(moved(com), acc_there, moved(anchor), n_there, LEAST)
    assert after == pytest.approx(before.item(), abs=1e-9)


# Anchor and normal


@given(share=st.floats(0.0, 1.0), load=st.floats(100.0, 1000.0))
def test_the_anchor_moves_from_foot_to_foot_as_the_load_does(share, load):
    feet = tensor([[0.1, 0.12, 0.0], [-0.1, -0.12, 0.2]])
    anchor = zmp.support_anchor(feet, tensor([share * load, (1.0 - share) * load]), 1e-9)
    torch.testing.assert_close(anchor, share * feet[0] + (1.0 - share) * feet[1], rtol=0, atol=1e-9)


def test_in_flight_the_anchor_is_midway_between_the_feet():
    feet = tensor([[0.1, 0.12, 0.0], [-0.1, -0.12, 0.2]])
    torch.testing.assert_close(zmp.support_anchor(feet, tensor([0.0, 0.0]), 1.0), feet.mean(dim=0))


def test_the_plane_is_that_of_the_foot_that_carries_more():
    normals = tensor([[0.0, 0.6, 0.8], [0.6, 0.0, 0.8]]).expand(3, 2, 3)
    force = tensor([[300.0, 20.0], [20.0, 300.0], [0.0, 0.0]])
    chosen = zmp.dominant_normal(normals, force)
    torch.testing.assert_close(chosen, torch.stack([normals[0, 0], normals[0, 1], normals[0, 0]]))


# Guards


@settings(max_examples=200)
@given(seed=seeds, scale=st.sampled_from([0.0, 1.0, 20.0, 1e3]), least=st.floats(0.1, 5.0))
def test_whatever_the_acceleration_and_the_plane_the_deviation_is_a_number_and_zero_where_it_is_undefined(
    seed, scale, least
):
    rng = np.random.default_rng(seed)
    normal = torch.nn.functional.normalize(torch.tensor(rng.normal(size=(16, 3)), dtype=torch.float32), dim=-1)
    com, anchor, acc = (torch.tensor(rng.normal(size=(16, 3)), dtype=torch.float32) for _ in range(3))
    deviation, valid = zmp_deviation(com, scale * acc, anchor, normal, least)
    assert deviation.isfinite().all()
    assert (deviation >= 0.0).all()
    assert (deviation[~valid] == 0.0).all()
    assert valid.equal((zmp.apparent_force(scale * acc) * normal).sum(-1) <= -least)


def test_in_free_fall_there_is_no_zmp():
    deviation, valid = zmp_deviation(UP, tensor([0.0, 0.0, -9.81]), torch.zeros_like(UP), UP, LEAST)
    assert not valid
    assert deviation == 0.0


def test_a_ray_along_the_plane_has_no_zmp_and_gives_no_infinity():
    # The apparent force is exactly along +x: it never meets a level plane.
    apparent_along_x = tensor([-3.0, 0.0, -9.81])
    deviation, valid = zmp_deviation(UP, apparent_along_x, torch.zeros_like(UP), UP, LEAST)
    assert not valid
    assert deviation == 0.0


def test_a_force_that_pulls_off_the_plane_has_no_zmp():
    _, valid = zmp_deviation(UP, tensor([0.0, 0.0, -30.0]), torch.zeros_like(UP), UP, LEAST)
    assert not valid
