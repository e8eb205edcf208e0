"""Rotations against SciPy's."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humoslope.slope import quaternion

seeds = st.integers(0, 2**32 - 1)


def draw(seed: int, n: int = 5) -> tuple[Rotation, torch.Tensor, np.ndarray]:
    """The same random rotations for SciPy and for torch (w, x, y, z), and random vectors."""
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(n, random_state=rng)
    return rotation, torch.tensor(rotation.as_quat(scalar_first=True)), rng.normal(size=(n, 3))


@given(seed=seeds)
def test_vectors_turn_as_scipy_turns_them_and_back(seed):
    rotation, q, v = draw(seed)
    np.testing.assert_allclose(quaternion.rotate(q, torch.tensor(v)), rotation.apply(v), atol=1e-12)
    np.testing.assert_allclose(quaternion.rotate_inverse(q, torch.tensor(v)), rotation.inv().apply(v), atol=1e-12)


@given(seed=seeds)
def test_a_quaternion_and_its_negative_are_the_same_rotation(seed):
    _, q, v = draw(seed)
    torch.testing.assert_close(quaternion.rotate(-q, torch.tensor(v)), quaternion.rotate(q, torch.tensor(v)))
    torch.testing.assert_close(quaternion.up_in_body(-q), quaternion.up_in_body(q))
    torch.testing.assert_close(quaternion.yaw(-q), quaternion.yaw(q))


@given(seed=seeds)
def test_the_vertical_seen_from_the_body_is_the_last_row_of_the_rotation_matrix(seed):
    rotation, q, _ = draw(seed)
    np.testing.assert_allclose(quaternion.up_in_body(q), rotation.as_matrix()[:, 2], atol=1e-12)


@given(yaw=st.floats(-3.1, 3.1), pitch=st.floats(-1.5, 1.5), roll=st.floats(-1.5, 1.5))
def test_yaw_is_the_heading_of_the_x_axis_whatever_pitch_and_roll(yaw, pitch, roll):
    rotation = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    heading = quaternion.yaw(torch.tensor(rotation.as_quat(scalar_first=True)))
    forward = rotation.apply([1.0, 0.0, 0.0])
    assert heading == pytest.approx(math.atan2(forward[1], forward[0]), abs=1e-9)
    assert heading == pytest.approx(yaw, abs=1e-9)


@given(angle=st.floats(-3.14, 3.14))
def test_from_yaw_is_a_turn_about_the_vertical(angle):
    q = quaternion.from_yaw(torch.tensor([angle], dtype=torch.float64))
    expected = Rotation.from_euler("z", angle).as_quat(scalar_first=True, canonical=True)
    np.testing.assert_allclose(q[0], expected, atol=1e-12)
    assert quaternion.yaw(q) == pytest.approx(angle, abs=1e-9)


def test_leading_dimensions_are_kept():
    q = quaternion.from_yaw(torch.linspace(-1.0, 1.0, 6).view(2, 3))
    assert q.shape == (2, 3, 4)
    assert quaternion.rotate(q, torch.ones(2, 3, 3)).shape == (2, 3, 3)
    assert quaternion.up_in_body(q).shape == (2, 3, 3)
    assert quaternion.yaw(q).shape == (2, 3)
