"""Smooth path of the point that the camera looks at: the robot without its bobbing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from humoslope.replay.rollout import Columns

SMOOTHING_S = 0.6
"""Standard deviation of the Gaussian filter, s; a step takes about half as long."""


def follow(columns: Columns, dt: float) -> NDArray[np.float32]:
    """Returns the smoothed position of the root [T, 3]; episodes are smoothed separately."""
    smooth = np.empty_like(columns.root_pos_w)
    for episode in np.unique(columns.episode):
        rows = columns.episode == episode
        smooth[rows] = gaussian_filter1d(columns.root_pos_w[rows], SMOOTHING_S / dt, axis=0, mode="nearest")
    return smooth
