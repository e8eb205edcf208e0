"""Buffers of past controls that MuJoCo keeps for actuators with a delay (`actuator_delay`)."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

_HEADER = 2  # a user's number and the cursor stand in front of the times and the values


def past_controls(model: mujoco.MjModel) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Returns the places [K] of all past controls in `MjData.history`, and the control [K] that each belongs to.

    `mj_resetData` makes them zero, as if every joint had been sent to zero before. Where a control that held before a
    reset means something else, they must be written.
    """
    places, controls = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for actuator in range(model.nu):
        samples = int(model.actuator_history[actuator, 0])
        if samples:
            first = model.actuator_historyadr[actuator] + _HEADER + samples
            places.append(first + np.arange(samples))
            controls.append(np.full(samples, actuator))
    return np.concatenate(places), np.concatenate(controls)
