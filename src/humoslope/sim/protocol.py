"""What the environment asks of a physics backend."""

from __future__ import annotations

from typing import Protocol

import mujoco
import torch
from torch import Tensor


class Simulation(Protocol):
    """Many worlds of one compiled MuJoCo model, stepped together.

    Readings are float32 tensors that the backend refreshes in place, of the instant of the last force computation:
    after `step` that is one physics step before the state, as with `mj_step`; after `reset` it is the state that was
    set. Keep a copy of what must outlive a step.

    Attributes:
        model: The compiled model all worlds started from.
        num_worlds: N.
        device: Where the tensors live.
        backend: "native" or "warp".
    """

    model: mujoco.MjModel
    num_worlds: int
    device: torch.device
    backend: str

    def read(self, field: str) -> Tensor:
        """A live view [N, ...] of a derived `MjData` field, such as "sensordata" or "actuator_force".
        Call once and keep it.

        Raises:
            UserError: If the field does not exist.
        """
        ...

    def state(self, field: str) -> Tensor:
        """A live view [N, ...] of a state field ("qpos", "qvel", "ctrl", "xfrc_applied", "time"),
        to read and to write in place.

        Its dtype is the backend's own (float64 native, float32 warp). What is written holds from the next step.
        """
        ...

    def expand(self, field: str) -> Tensor:
        """Gives a model field ("geom_friction", "body_mass", ...) one value per world:
        a live view [N, ...], to write in place.

        Values derived from a field that was written follow only after `recompute_constants`.
        """
        ...

    def recompute_constants(self) -> None:
        """Derives the model constants that follow from masses, inertias and positions again, in every world
        (`mj_setConst`)."""
        ...

    def step(self, n: int, mask: Tensor | None = None) -> None:
        """Advances every world by `n` physics steps with the controls and wrenches held.

        Args:
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

        Warm start and time of those worlds become zero. The other worlds and their readings stay as they are.

        Args:
            qpos, qvel: [N, nq] and [N, nv].
            ctrl: [N, nu]; zero by default.
            xfrc_applied: [N, nbody, 6] force and torque on each body; zero by default.
        """
        ...

    def known_empty(self, mask: Tensor) -> bool:
        """Whether it is known without waiting for the device that `mask` [N] holds in no world.

        Where the worlds live on the host that is a look; a GPU never knows.
        """
        ...

    def known_rows(self, mask: Tensor) -> Tensor | slice:
        """An index of the worlds to work on so that those in `mask` [N] are among them, without waiting for the device:
        they alone where the worlds live on the host, all worlds on a GPU."""
        ...

    def diverged(self) -> Tensor:
        """Worlds [N] (bool) that went numerically wrong since they were last reset."""
        ...

    def warnings(self) -> list[str]:
        """What the user should know of the physics since the last call (full buffers, with the field to raise).
        May synchronise."""
        ...
