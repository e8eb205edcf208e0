"""What orientations say of heading and tilt. A quaternion is (w, x, y, z), of length 1, and turns body axes into world
axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def yaw(quat: Array) -> Array:
    """Returns the headings [...] of orientations [..., 4]: the angle of the body's x axis about the vertical, rad."""
    w, x, y, z = (quat[..., i] for i in range(4))
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def up_b(quat: Array) -> Array:
    """Returns the world's up direction in body axes, [..., 3], the last row of each orientation's matrix, [..., 4]."""
    w, x, y, z = (quat[..., i] for i in range(4))
    return np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=-1)
