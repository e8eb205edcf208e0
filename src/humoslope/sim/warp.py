"""MuJoCo-Warp: all worlds in lock-step on a GPU. On the CPU it runs too, slowly, so that it can be compared."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import mujoco
import torch
import warp as wp
from torch import Tensor

from humoslope.errors import UserError
from humoslope.sim.fields import check_model_field, check_reading, check_reset, check_state, no_access

# Else a banner and a line for each of some fifty kernel modules go into every run's log.
wp.config.log_level = wp.LOG_WARNING

import mujoco_warp as mjw  # noqa: E402
from mujoco_warp import OverflowType  # noqa: E402

# What mj_setConst derives and the physics uses. The kernels fill as many worlds as the array has, so each needs one.
_DERIVED = (
    "body_subtreemass",
    "body_invweight0",
    "dof_invweight0",
    "tendon_length0",
    "tendon_lengthspring",
    "tendon_invweight0",
    "actuator_acc0",
)

# Beyond this mj_step calls a value bad (mjMAXVAL).
_LARGEST = float(mujoco.mjMAXVAL)


class WarpSimulation:
    """`Simulation` on MuJoCo-Warp, float32.

    MuJoCo-Warp keeps contacts in one buffer for all worlds and constraints in one buffer per world, of fixed size. What
    does not fit is left out of the physics; `warnings` tells when that happened.

    Args:
        model: The compiled model.
        num_worlds: N.
        device: Where the worlds live.
        nconmax: Contacts to make room for, per world on average.
        njmax: Constraint rows to make room for in each world; a contact takes three, or four with a pyramidal cone.

    Raises:
        UserError: If MuJoCo-Warp does not support something in the model.
    """

    backend = "warp"

    def __init__(
        self, model: mujoco.MjModel, num_worlds: int, device: torch.device, nconmax: int = 48, njmax: int = 192
    ) -> None:
        self.model = model
        self.num_worlds = num_worlds
        wp.init()
        self._wp_device = wp.device_from_torch(device)
        self.device = torch.device(wp.device_to_torch(self._wp_device))
        self._nconmax = nconmax
        with wp.ScopedDevice(self._wp_device):
            try:
                self._m: Any = mjw.put_model(model)
                self._d: Any = mjw.make_data(model, nworld=num_worlds, nconmax=nconmax, njmax=njmax)
            except NotImplementedError as error:
                raise UserError(f"MuJoCo-Warp cannot run this model: {error}") from None
            self._peak = wp.zeros(2, dtype=int)
            wp.synchronize_device()  # from here on everything is ordered by torch's stream
        self._m.opt.warn_overflow = 0  # `warnings` reports instead of a print from every world at every step
        # A robot that lies down touches the ground with more geoms than nconmax allows for the average world.
        self._m.opt.contact_sensor_maxmatch = max(self._m.opt.contact_sensor_maxmatch, 2 * nconmax)
        self._graphs: dict[str, Any] = {}
        self._expanded: dict[str, Tensor] = {}
        self._readings: dict[str, tuple[Tensor, Tensor]] = {}  # what was handed out, and MuJoCo-Warp's own array
        self._qpos, self._qvel = self.state("qpos"), self.state("qvel")
        self._ctrl, self._wrench = self.state("ctrl"), self.state("xfrc_applied")
        zeroed = ("ctrl", "xfrc_applied", "qfrc_applied", "qacc_warmstart", "act", "time")
        self._zeroed = [wp.to_torch(getattr(self._d, field)) for field in zeroed]

    def read(self, field: str) -> Tensor:
        """See `Simulation.read`."""
        check_reading(self.model, field)
        if field not in self._readings:
            shape = getattr(mujoco.MjData(self.model), field).shape
            live = self._view(self._d, field, shape)
            self._readings[field] = (live.clone(), live)
        return self._readings[field][0]

    def state(self, field: str) -> Tensor:
        """See `Simulation.state`. Float32."""
        check_state(field)
        return wp.to_torch(getattr(self._d, field))

    def expand(self, field: str) -> Tensor:
        """See `Simulation.expand`. Float32."""
        if field not in self._expanded:
            check_model_field(self.model, field)
            shape = getattr(self.model, field).shape
            self._view(self._m, field, shape)  # raises if there is no such array
            self._tile(self._m, field)
            self._expanded[field] = self._view(self._m, field, shape)
        return self._expanded[field]

    def recompute_constants(self) -> None:
        """See `Simulation.recompute_constants`."""
        for field in _DERIVED:
            self._tile(self._m, field)
        self._tile(self._m.stat, "meaninertia")
        with self._on_torch_stream():
            mjw.set_const(self._m, self._d)

    def step(self, n: int, mask: Tensor | None = None) -> None:
        """See `Simulation.step`. Worlds go in lock-step, so none is spared."""
        for _ in range(n):
            self._run("step", mjw.step)
        for reading, live in self._readings.values():
            reading.copy_(live)

    def reset(
        self,
        mask: Tensor,
        qpos: Tensor,
        qvel: Tensor,
        ctrl: Tensor | None = None,
        xfrc_applied: Tensor | None = None,
    ) -> None:
        """See `Simulation.reset`. The forces of all worlds are computed; those outside the mask are left unread."""
        check_reset(self.model, self.num_worlds, mask, qpos, qvel)
        _replace(self._qpos, mask, qpos)
        _replace(self._qvel, mask, qvel)
        for array in self._zeroed:
            array.masked_fill_(_like(mask, array), 0.0)
        for target, value in ((self._ctrl, ctrl), (self._wrench, xfrc_applied)):
            if value is not None:
                _replace(target, mask, value)
        self._run("forward", mjw.forward)
        for reading, live in self._readings.values():
            _replace(reading, mask, live)

    def known_empty(self, mask: Tensor) -> bool:
        """See `Simulation.known_empty`. Looking would wait for the device."""
        return False

    def known_rows(self, mask: Tensor) -> Tensor | slice:
        """See `Simulation.known_rows`."""
        return slice(None)

    def diverged(self) -> Tensor:
        """See `Simulation.diverged`. Nothing puts a broken world right but a reset, so its state tells."""
        fine = self._qpos.abs().amax(dim=1) <= _LARGEST  # false for NaN
        return ~(fine & (self._qvel.abs().amax(dim=1) <= _LARGEST))

    def warnings(self) -> list[str]:
        """See `Simulation.warnings`. Synchronises."""
        seen = 0
        for bits in self._d.overflow.numpy():
            seen |= int(bits)
        rows, contacts = (int(value) for value in self._peak.numpy())
        self._d.overflow.zero_()
        self._peak.zero_()
        contacts_full = (
            f"was full ({contacts} contacts at the peak, room for {self._d.naconmax} in {self.num_worlds} worlds)"
        )
        raise_njmax, raise_nconmax = f"raise njmax from {self._d.njmax}.", f"raise nconmax from {self._nconmax}."
        advice = {
            OverflowType.NEFC: f"the constraint buffer was full ({rows} rows at the peak); {raise_njmax}",
            OverflowType.NJMAX_NNZ: f"the constraint Jacobian was full ({rows} rows at the peak); {raise_njmax}",
            OverflowType.BROADPHASE | OverflowType.NARROWPHASE: f"the contact buffer {contacts_full}; {raise_nconmax}",
            OverflowType.CCD: f"the convex collision buffer {contacts_full}; {raise_nconmax}",
            OverflowType.HFIELD: "a geom met more cells of the height field than MuJoCo-Warp handles; enlarge them.",
            OverflowType.CONTACT_MATCH: f"a contact sensor saw more contacts than it can hold; {raise_nconmax}",
        }
        return [text for bit, text in advice.items() if seen & bit]

    def _run(self, name: str, function: Callable[[Any, Any], None]) -> None:
        """Runs a stage of the physics, as one captured graph on CUDA."""
        if self._wp_device.is_cuda:
            if name not in self._graphs:
                with wp.ScopedDevice(self._wp_device), wp.ScopedCapture() as capture:
                    self._run_now(function)
                self._graphs[name] = capture.graph
            wp.capture_launch(self._graphs[name], stream=self._torch_stream())
        else:
            with wp.ScopedDevice(self._wp_device):
                self._run_now(function)

    def _run_now(self, function: Callable[[Any, Any], None]) -> None:
        function(self._m, self._d)
        counts = [self._d.nefc, self._d.nacon, self._d.ncollision]
        wp.launch(_note_peaks, dim=self.num_worlds, inputs=counts, outputs=[self._peak])

    def _torch_stream(self) -> Any:
        # torch's own stream: what torch wrote before is seen and what it reads after is waited for, with no host sync.
        return wp.stream_from_torch(torch.cuda.current_stream(self.device))

    def _on_torch_stream(self) -> AbstractContextManager[Any]:
        return wp.ScopedStream(self._torch_stream()) if self._wp_device.is_cuda else wp.ScopedDevice(self._wp_device)

    def _view(self, struct: Any, field: str, shape: tuple[int, ...]) -> Tensor:
        """The array as a torch tensor [N or 1, *shape]; vectors and matrices are flat as in MuJoCo."""
        array = getattr(struct, field, None)
        if not isinstance(array, wp.array):
            raise no_access(field, self.backend)
        flat = wp.to_torch(array).flatten(1)
        if flat.shape[1] != torch.Size(shape).numel():
            raise no_access(field, self.backend)
        return flat.view(flat.shape[0], *shape)

    def _tile(self, struct: Any, field: str) -> None:
        """Gives a model array one row per world. Kernels index it modulo its length."""
        array = getattr(struct, field)
        if array.shape[0] == self.num_worlds:
            return
        source = wp.to_torch(array)
        with self._on_torch_stream():
            tiled = wp.empty((self.num_worlds, *array.shape[1:]), dtype=array.dtype, device=self._wp_device)
        wp.to_torch(tiled).copy_(source.expand(self.num_worlds, *source.shape[1:]))
        setattr(struct, field, tiled)
        self._graphs.clear()  # they hold the old array's address


def _like(mask: Tensor, array: Tensor) -> Tensor:
    return mask.view(-1, *(1,) * (array.dim() - 1))


def _replace(target: Tensor, mask: Tensor, value: Tensor) -> None:
    target.copy_(torch.where(_like(mask, target), value.to(target.dtype), target))


@wp.kernel(enable_backward=False)  # type: ignore[untyped-decorator]
def _note_peaks(
    nefc: wp.array[int],
    nacon: wp.array[int],
    ncollision: wp.array[int],
    peak: wp.array[int],
) -> None:
    """Keeps the largest number of constraint rows in a world and of contacts in all worlds."""
    world = wp.tid()
    wp.atomic_max(peak, 0, nefc[world])  # type: ignore[call-overload]
    if world == 0:
        wp.atomic_max(peak, 1, wp.max(nacon[0], ncollision[0]))  # type: ignore[call-overload]
