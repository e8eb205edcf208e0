"""C MuJoCo on a pool of CPU threads (mjbatch)."""

from __future__ import annotations

from typing import Any

import mjbatch
import mujoco
import numpy as np
import torch
from mujoco import mjtState, mjtWarning
from numpy.typing import NDArray
from torch import Tensor

from humoslope.cpu import usable_cores
from humoslope.errors import UserError
from humoslope.sim.fields import (
    FASTEST,
    STATE_FIELDS,
    check_model_field,
    check_reading,
    check_reset,
    check_state,
    no_access,
)
from humoslope.sim.history import past_controls

# mj_step resets a world with a bad position, velocity or acceleration and goes on, and treats a bad control as zero;
# the only trace is a counter.
_FIRST_BAD = int(mjtWarning.mjWARN_BADQPOS)
_FULL = ("contact", "constraint")
_FULL_KINDS = [int(mjtWarning.mjWARN_CONTACTFULL), int(mjtWarning.mjWARN_CNSTRFULL)]

# Parts of the state that stand before the history buffers in a row.
_BEFORE_HISTORY = int(mjtState.mjSTATE_TIME | mjtState.mjSTATE_QPOS | mjtState.mjSTATE_QVEL | mjtState.mjSTATE_ACT)

_FRAMES = ("body_ipos", "body_iquat", "geom_pos", "geom_quat", "site_pos", "site_quat")


class NativeSimulation:
    """`Simulation` on the CPU. State is float64 and steps are those of `mj_step`, bit for bit.

    A reading holds zeros between the first `read` of it and the next step or reset.
    """

    backend = "native"

    def __init__(self, model: mujoco.MjModel, num_worlds: int, num_threads: int = 0) -> None:
        self.model = model
        self.num_worlds = num_worlds
        self.device = torch.device("cpu")
        self._batch = mjbatch.Batch(model, num_worlds, num_threads or usable_cores())
        self._rows: NDArray[np.float64] = self._batch.bind("state")  # [N, nstate]
        self._fresh = _initial_state(model)
        self._state = {field: self._batch.bind(field) for field in STATE_FIELDS}
        self._past, self._past_of = past_controls(model)
        self._past += mujoco.mj_stateSize(model, _BEFORE_HISTORY)
        self._expanded: dict[str, Tensor] = {}
        self._readings: dict[str, Tensor] = {}
        self._lent: set[int] = set()  # addresses of the memory behind tensors that were given away
        self._qpos, self._qvel = self.state("qpos"), self.state("qvel")
        self._warning: NDArray[np.int32] = self._batch.bind("warning")  # [N, kind, (last info, count)]
        # Times a buffer was full in episodes that were reset since, and times that were reported.
        self._full_before = np.zeros(len(_FULL), dtype=np.int64)
        self._full_reported = np.zeros(len(_FULL), dtype=np.int64)

    def read(self, field: str) -> Tensor:
        """See `Simulation.read`."""
        check_reading(self.model, field)
        try:
            self._readings[field] = self._lend(self._batch.bind(field, np.float32))
        except ValueError:
            raise no_access(field, self.backend) from None
        return self._readings[field]

    def state(self, field: str) -> Tensor:
        """See `Simulation.state`. A strided float64 view into the rows that the physics reads."""
        check_state(field)
        return self._lend(self._state[field])

    def expand(self, field: str) -> Tensor:
        """See `Simulation.expand`. Float64, so that worlds left alone keep the model's exact values."""
        if field in self._expanded:
            return self._expanded[field]
        check_model_field(self.model, field)
        try:
            values = self._lend(self._batch.expand(field))
        except ValueError:
            raise no_access(field, self.backend) from None
        if field in _FRAMES:
            # The compiler marks frames that coincide, and mj_kinematics copies one instead of computing the other. Once
            # a frame moves, the marks would lock its neighbours to it, or it to its body.
            for marks in ("body_sameframe", "geom_sameframe", "site_sameframe"):
                self._batch.expand(marks)[:] = 0
        self._expanded[field] = values
        return values

    def recompute_constants(self) -> None:
        """See `Simulation.recompute_constants`."""
        self._batch.set_const()

    def step(self, n: int, mask: Tensor | None = None) -> None:
        """See `Simulation.step`."""
        try:
            self._batch.step(None if mask is None else mask.numpy(), nstep=n)
        except RuntimeError as error:
            if "out of memory" not in str(error):
                raise
            raise UserError("MuJoCo's memory is full of contacts; raise <size memory> in the model.") from error

    def reset(
        self,
        mask: Tensor,
        qpos: Tensor,
        qvel: Tensor,
        ctrl: Tensor | None = None,
        xfrc_applied: Tensor | None = None,
    ) -> None:
        """See `Simulation.reset`."""
        check_reset(self.model, self.num_worlds, mask, qpos, qvel)
        chosen = mask.numpy()
        if not chosen.any():
            return
        self._rows[chosen] = self._fresh
        for field, value in (("qpos", qpos), ("qvel", qvel), ("ctrl", ctrl), ("xfrc_applied", xfrc_applied)):
            if value is not None:
                self._state[field][chosen] = value.numpy()[chosen]
        if len(self._past):
            rows = np.flatnonzero(chosen)[:, None]
            self._rows[rows, self._past] = self._state["ctrl"][rows, self._past_of]
        self._full_before += self._warning[chosen][:, _FULL_KINDS, 1].sum(axis=0)
        self._warning[chosen] = 0
        self._batch.forward(ids=chosen)

    def known_empty(self, mask: Tensor) -> bool:
        """See `Simulation.known_empty`."""
        return not mask.numpy().any()

    def known_rows(self, mask: Tensor) -> Tensor | slice:
        """See `Simulation.known_rows`."""
        return mask.nonzero().squeeze(1)

    def diverged(self) -> Tensor:
        """See `Simulation.diverged`."""
        bad = self._warning[:, _FIRST_BAD:, 1].any(axis=1)
        # Only the last physics step of a call can leave a NaN uncounted; it makes the sum NaN and the comparison false.
        fine = self._qpos.sum(dim=1).isfinite() & (self._qvel.abs().amax(dim=1) <= FASTEST)
        return torch.from_numpy(bad) | ~fine

    def owns(self, tensor: Tensor) -> bool:
        """See `Simulation.owns`."""
        return tensor.untyped_storage().data_ptr() in self._lent

    def snapshot(self) -> dict[str, Any] | None:
        """See `Simulation.snapshot`."""
        return {
            "rows": torch.from_numpy(self._rows.copy()),
            "warning": torch.from_numpy(self._warning.copy()),
            "expanded": {field: values.clone() for field, values in self._expanded.items()},
            "readings": {field: values.clone() for field, values in self._readings.items()},
        }

    def snapshot_bytes(self) -> int:
        """See `Simulation.snapshot_bytes`."""
        tensors = (*self._expanded.values(), *self._readings.values())
        return self._rows.nbytes + self._warning.nbytes + sum(tensor.nbytes for tensor in tensors)

    def restore(self, snapshot: dict[str, Any]) -> None:
        """See `Simulation.restore`."""
        for field, values in snapshot["expanded"].items():
            self.expand(field).copy_(values)
        if self._expanded:
            self.recompute_constants()
        self._rows[:] = snapshot["rows"].numpy()
        self._warning[:] = snapshot["warning"].numpy()
        for field, values in snapshot["readings"].items():
            self.read(field).copy_(values)

    def _lend(self, array: NDArray[Any]) -> Tensor:
        tensor = torch.from_numpy(array)
        self._lent.add(tensor.untyped_storage().data_ptr())
        return tensor

    def warnings(self) -> list[str]:
        """See `Simulation.warnings`. Both buffers live in the model's arena, whose size is `<size memory="...">`."""
        counts = self._full_before + self._warning[:, _FULL_KINDS, 1].sum(axis=0)
        new, self._full_reported = counts - self._full_reported, counts
        return [
            f"the {name} buffer was full {times} times, so {name}s were lost; raise <size memory> in the model."
            for name, times in zip(_FULL, new, strict=True)
            if times > 0
        ]


def _initial_state(model: mujoco.MjModel) -> NDArray[np.float64]:
    data = mujoco.MjData(model)
    kind = mjtState.mjSTATE_INTEGRATION
    row = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, row, kind)
    return row
