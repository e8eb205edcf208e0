"""Heading and tilt of orientations, against MuJoCo's rotation matrices."""

from __future__ import annotations

import mujoco
import numpy as np

from humoslope.deploy import rotation


def test_heading_and_up_are_those_of_the_rotation_matrix() -> None:
    quats = np.random.default_rng(0).normal(size=(3, 20, 4))
    quats /= np.linalg.norm(quats, axis=-1, keepdims=True)
    matrices = np.zeros((3, 20, 9))
    for index in np.ndindex(3, 20):
        mujoco.mju_quat2Mat(matrices[index], quats[index])
    matrices = matrices.reshape(3, 20, 3, 3)
    np.testing.assert_allclose(rotation.up_b(quats), matrices[..., 2, :], atol=1e-12)
    np.testing.assert_allclose(rotation.yaw(quats), np.arctan2(matrices[..., 1, 0], matrices[..., 0, 0]), atol=1e-12)
    assert rotation.up_b(quats[0, 0]).shape == (3,)
    assert float(rotation.yaw(quats[0, 0])) == rotation.yaw(quats)[0, 0]
