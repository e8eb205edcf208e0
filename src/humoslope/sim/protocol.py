"""Interface between the environment and a physics backend."""

from __future__ import annotations

from typing import Any, Protocol

import mujoco
import torch
from torch import Tensor


class Simulation(Protocol):
    """Many worlds of one compiled MuJoCo model, stepped together.

    State is what the integrator carries on (`qpos`, `qvel`, ...); readings are what the last force computation derived
    (`sensordata`, `actuator_force`, `xpos`, ...). They are float32 tensors that the backend refreshes in place:

    - after `step`, of the instant one physics step before the state, as with `mj_step`;
    - after `reset`, of the state, controls and wrenches that were set, in the worlds that were reset.

    A reading has its first meaningful value after the first `step` or `reset` that follows `read`. Copy what must
    outlive a step. Two runs of the same commands agree bit for bit on a CPU; on a GPU contacts are found in any order,
    so that sums of their forces differ in the last digits.

    Attributes:
        model: Compiled model that all worlds started from.
        num_worlds: N.
        device: Device of all tensors.
        backend: "native" or "warp".
    """

    model: mujoco.MjModel
    num_worlds: int
    device: torch.device
    backend: str

    def read(self, field: str) -> Tensor:
        """Returns a live view [N, ...] of a derived `MjData` field, such as "sensordata" or "actuator_force".
        Call once and keep it.

        Raises:
            UserError: If the field does not exist.
        """
        ...

    def state(self, field: str) -> Tensor:
        """Returns a live view [N, ...] of a state field ("qpos", "qvel", "ctrl", "xfrc_applied", "time"),
        to read and to write in place.

        Its dtype is the backend's own (float64 native, float32 warp). What is written holds from the next step.
        """
        ...

    def expand(self, field: str) -> Tensor:
        """Gives a model field ("geom_friction", "body_mass", ...) one value per world and returns a live view [N, ...],
        to write in place.

        Values derived from a field that was written follow only after `recompute_constants`.
        """
        ...

    def recompute_constants(self) -> None:
        """Computes again, in every world, the model constants that follow from masses, inertias and positions
        (`mj_setConst`)."""
        ...

    def step(self, n: int, mask: Tensor | None = None) -> None:
        """Advances every world by `n` physics steps with the controls and wrenches held.

        Args:
            n: Physics steps.
            mask: [N] bool; the worlds that matter. The native backend leaves the others as they are and saves their
                time; MuJoCo-Warp steps all worlds alike.
        """
        ...

    def reset(
        self,
        mask: Tensor,
        qpos: Tensor,
        qvel: Tensor,
        ctrl: Tensor | None = None,
        xfrc_applied: Tensor | None = None,
    ) -> None:
        """Starts the worlds in `mask` [N] anew; their readings become those of the new state, controls and wrenches.

        Warm start and time of those worlds become zero; where actuators have a delay, their controls have always held.
        The other worlds and their readings stay as they are.

        Args:
            qpos, qvel: [N, nq] and [N, nv].
            ctrl: [N, nu]; zero by default.
            xfrc_applied: [N, nbody, 6] force and torque on each body; zero by default.
        """
        ...

    def known_empty(self, mask: Tensor) -> bool:
        """Returns whether `mask` [N] is false everywhere, as far as that is known without waiting for the device.

        On the host it is known; a GPU's answer is always false.
        """
        ...

    def known_rows(self, mask: Tensor) -> Tensor | slice:
        """Returns an index of worlds that include those in `mask` [N], without waiting for the device: exactly those on
        the host, all worlds on a GPU."""
        ...

    def diverged(self) -> Tensor:
        """Returns the worlds [N] (bool) whose physics failed since they were last reset: a value is not finite, or a
        velocity is beyond `fields.FASTEST`."""
        ...

    def owns(self, tensor: Tensor) -> bool:
        """Returns whether a tensor is a view of the physics' own memory that this object has lent."""
        ...

    def snapshot(self) -> dict[str, Any] | None:
        """Returns a copy of all from which the steps to come follow: state, warm start, model fields, readings; None if
        this backend cannot go on from one exactly."""
        ...

    def snapshot_bytes(self) -> int:
        """Returns the memory that a snapshot takes, bytes; 0 if there is none."""
        ...

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Goes on from a snapshot of a simulation of the same model and size."""
        ...

    def warnings(self) -> list[str]:
        """Returns sentences about the physics since the last call, such as full buffers with the field to raise.
        May wait for the device."""
        ...
