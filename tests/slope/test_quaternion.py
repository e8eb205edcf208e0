"""Rotations against SciPy's."""

from __future__ import annotations

import numpy as np
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
def test_vectors_turn_as_scipy_turns_them(seed):
    rotation, q, v = draw(seed)
    np.testing.assert_allclose(quaternion.rotate(q, torch.tensor(v)), rotation.apply(v), atol=1e-12)
    np.testing.assert_allclose(quaternion.matrix(q), rotation.as_matrix(), atol=1e-12)


@given(seed=seeds)
def test_a_quaternion_and_its_negative_are_the_same_rotation(seed):
    _, q, v = draw(seed)
    torch.testing.assert_close(quaternion.rotate(-q, torch.tensor(v)), quaternion.rotate(q, torch.tensor(v)))


@given(angle=st.floats(-3.14, 3.14))
def test_from_yaw_is_a_turn_about_the_vertical(angle):
    q = quaternion.from_yaw(torch.tensor([angle], dtype=torch.float64))
    expected = Rotation.from_euler("z", angle).as_quat(scalar_first=True, canonical=True)
    np.testing.assert_allclose(q[0], expected, atol=1e-12)


def test_leading_dimensions_are_kept():
    q = quaternion.from_yaw(torch.linspace(-1.0, 1.0, 6).view(2, 3))
    assert q.shape == (2, 3, 4)
    assert quaternion.rotate(q, torch.ones(2, 3, 3)).shape == (2, 3, 3)
    assert quaternion.matrix(q).shape == (2, 3, 3, 3)
