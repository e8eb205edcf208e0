"""MuJoCo-Warp: all worlds in lock-step on a GPU. It also runs on the CPU, so that the two backends can be compared."""

from __future__ import annotations

import gc
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import mujoco
import torch
import warp as wp
from torch import Tensor

from humoslope.errors import UserError
from humoslope.sim.fields import (
    FASTEST,
    check_model_field,
    check_reading,
    check_reset,
    check_state,
    no_access,
    replace,
)
from humoslope.sim.height_field import collide_near_geoms
from humoslope.sim.history import past_controls

# Else a banner and a line for each of some fifty kernel modules go into every run's log.
wp.config.log_level = wp.LOG_WARNING

import mujoco_warp as mjw  # noqa: E402
from mujoco_warp import OverflowType  # noqa: E402
from mujoco_warp._src.collision_driver import MJ_COLLISION_TABLE  # noqa: E402
from mujoco_warp._src.math import upper_trid_index  # noqa: E402
from mujoco_warp._src.types import CollisionType, GeomType  # noqa: E402

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

UNREPORTED = (
    OverflowType.ITERATIONS  # the solver's limit is meant to be reached in some worlds; C MuJoCo does not report it
    | OverflowType.LS_ITERATIONS
    | OverflowType.NVMAX  # sleeping islands and tactile sensors are in no model of ours
    | OverflowType.TACTILE
)
"""Overflow bits that are no reason for a warning."""

_SMALLEST_POOL = 4
"""Worlds' worth of contacts that the buffer has at least: one robot that lies down needs more than the average."""


class WarpSimulation:
    """`Simulation` on MuJoCo-Warp, float32.

    MuJoCo-Warp keeps contacts in one buffer for all worlds and constraints in one buffer per world, of fixed sizes.
    What does not fit is left out of the physics, and `warnings` reports it.

    Args:
        model: The compiled model.
        num_worlds: N.
        device: Device of the worlds.
        nconmax: Room for contacts, per world on average.
        njmax: Room for constraint rows in each world; a contact takes three, or four with a pyramidal cone.

    Attributes:
        captures: Whether stages of the physics run as captured graphs; else kernel by kernel, with the same result.

    Raises:
        UserError: If MuJoCo-Warp does not support something in the model, or the device's memory is too small.
    """

    backend = "warp"

    def __init__(
        self, model: mujoco.MjModel, num_worlds: int, device: torch.device, nconmax: int = 48, njmax: int = 192
    ) -> None:
        self.model = model
        self.num_worlds = num_worlds
        collide_near_geoms()
        wp.init()
        self._wp_device = wp.device_from_torch(device)
        self.device = torch.device(wp.device_to_torch(self._wp_device))
        self._nconmax = nconmax
        # Allocations inside a capture need memory pools, which virtual GPUs and some containers lack.
        self.captures = not self._wp_device.is_cuda or bool(wp.is_mempool_enabled(self._wp_device))
        self._slow_reported = self.captures
        with wp.ScopedDevice(self._wp_device), self._memory_told():
            try:
                with warnings.catch_warnings():
                    # Of several contacts per cell; a height field makes contacts with several cells.
                    warnings.filterwarnings("ignore", message="MULTICCD is enabled")
                    self._m: Any = mjw.put_model(model)
            except NotImplementedError as error:
                raise UserError(f"MuJoCo-Warp cannot run this model: {error}") from None
            naconmax = nconmax * max(num_worlds, _SMALLEST_POOL)
            # Flexes count their pairs otherwise.
            naccdmax = naconmax if model.nflex else min(naconmax, _convex_pairs(self._m) * num_worlds)
            self._d: Any = mjw.make_data(model, nworld=num_worlds, naconmax=naconmax, naccdmax=naccdmax, njmax=njmax)
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
        self._history = wp.to_torch(self._d.history)  # [N, nhistory]
        fresh = mujoco.MjData(model).history
        self._fresh_history = torch.as_tensor(fresh, dtype=torch.float32, device=self.device)
        self._past, self._past_of = (torch.as_tensor(index, device=self.device) for index in past_controls(model))

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
        replace(self._qpos, mask, qpos)
        replace(self._qvel, mask, qvel)
        for array in self._zeroed:
            array.masked_fill_(_like(mask, array), 0.0)
        for target, value in ((self._ctrl, ctrl), (self._wrench, xfrc_applied)):
            if value is not None:
                replace(target, mask, value)
        if self.model.nhistory:
            history = self._fresh_history.repeat(self.num_worlds, 1)
            history[:, self._past] = self._ctrl[:, self._past_of]
            replace(self._history, mask, history)
        self._run("forward", mjw.forward)
        for reading, live in self._readings.values():
            replace(reading, mask, live)

    def known_empty(self, mask: Tensor) -> bool:
        """See `Simulation.known_empty`. Looking would wait for the device."""
        return False

    def known_rows(self, mask: Tensor) -> Tensor | slice:
        """See `Simulation.known_rows`."""
        return slice(None)

    def diverged(self) -> Tensor:
        """See `Simulation.diverged`. A broken world stays broken until its reset, so its state shows it."""
        fine = self._qpos.abs().amax(dim=1) <= _LARGEST  # false for NaN
        return ~(fine & (self._qvel.abs().amax(dim=1) <= FASTEST))

    def owns(self, tensor: Tensor) -> bool:
        """See `Simulation.owns`; there is no snapshot that would need it."""
        return False

    def snapshot(self) -> dict[str, Any] | None:
        """See `Simulation.snapshot`. A GPU finds contacts in any order, so that no two runs agree to the last digit."""
        return None

    def snapshot_bytes(self) -> int:
        """See `Simulation.snapshot_bytes`."""
        return 0

    def restore(self, snapshot: dict[str, Any]) -> None:
        """See `Simulation.restore`.

        Raises:
            NotImplementedError: Always; there is no snapshot.
        """
        raise NotImplementedError

    def warnings(self) -> list[str]:
        """See `Simulation.warnings`. Synchronises."""
        seen = 0
        with self._on_torch_stream():
            for bits in self._d.overflow.numpy():
                seen |= int(bits)
            rows, contacts = (int(value) for value in self._peak.numpy())
            self._d.overflow.zero_()
            self._peak.zero_()
        slow = f"{self.device} has no CUDA memory pools, so the physics runs without graphs, many times slower."
        told = [] if self._slow_reported else [slow]
        self._slow_reported = True
        return told + [text for bit, text in self._advice(rows, contacts).items() if seen & bit]

    def _advice(self, rows: int, contacts: int) -> dict[OverflowType, str]:
        contacts_full = (
            f"was full ({contacts} contacts at the peak, room for {self._d.naconmax} in {self.num_worlds} worlds)"
        )
        raise_njmax, raise_nconmax = f"raise njmax from {self._d.njmax}.", f"raise nconmax from {self._nconmax}."
        return {
            OverflowType.NEFC: f"the constraint buffer was full ({rows} rows at the peak); {raise_njmax}",
            OverflowType.NJMAX_NNZ: f"the constraint Jacobian was full ({rows} rows at the peak); {raise_njmax}",
            OverflowType.BROADPHASE | OverflowType.NARROWPHASE: f"the contact buffer {contacts_full}; {raise_nconmax}",
            OverflowType.CCD: f"the convex collision buffer {contacts_full}; {raise_nconmax}",
            OverflowType.HFIELD: "a geom met more cells of the height field than MuJoCo-Warp handles; enlarge them.",
            OverflowType.CONTACT_MATCH: f"a contact sensor saw more contacts than it can hold; {raise_nconmax}",
            OverflowType.EPA_HORIZON: (
                "a collision was too complex for MuJoCo-Warp (EPA horizon), so a contact was lost; use simpler geoms."
            ),
        }

    def _run(self, name: str, function: Callable[[Any, Any], None]) -> None:
        """Runs a stage of the physics as one captured graph.

        Warp captures and replays on the CPU as well, where it is thirteen times faster than launching kernel by kernel.
        """
        if not self.captures:
            with self._on_torch_stream():
                self._run_now(function)
            return
        # Without the device the graph would go to the default stream of the current one, unordered with torch's work.
        with wp.ScopedDevice(self._wp_device), self._memory_told():
            if name not in self._graphs:
                # The capture cannot use torch's stream: CUDA does not capture its default stream.
                with _no_garbage_collection(), wp.ScopedCapture() as capture:
                    self._run_now(function)
                self._graphs[name] = capture.graph
            wp.capture_launch(self._graphs[name], stream=self._torch_stream() if self._wp_device.is_cuda else None)

    def _run_now(self, function: Callable[[Any, Any], None]) -> None:
        function(self._m, self._d)
        counts = [self._d.nefc, self._d.nacon, self._d.ncollision]
        wp.launch(_note_peaks, dim=self.num_worlds, inputs=counts, outputs=[self._peak])

    @contextmanager
    def _memory_told(self) -> Iterator[None]:
        """Turns a failed allocation into a UserError."""
        try:
            yield
        except RuntimeError as error:  # torch.OutOfMemoryError is one
            if not any(sign in str(error).lower() for sign in ("failed to allocate", "out of memory")):
                raise
            raise UserError(
                f"the memory of {self.device} is too small for {self.num_worlds} worlds; use a smaller num_envs."
            ) from error

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


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Keeps Python from freeing CUDA objects during a capture, which would break it."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _convex_pairs(model: Any) -> int:
    """Most pairs of one kind of geoms that a world can send to the convex collider, at least 1.

    MuJoCo-Warp counts the pairs of each kind separately, and makes room for naccdmax of each. 5 kB per pair make this
    the largest buffer by far; by default it would hold nconmax pairs per world.
    """
    kinds = (kind for kind, collider in MJ_COLLISION_TABLE.items() if collider == CollisionType.CONVEX)
    count = model.geom_pair_type_count
    return max(1, *(int(count[upper_trid_index(len(GeomType), int(a), int(b))]) for a, b in kinds))


def _like(mask: Tensor, array: Tensor) -> Tensor:
    return mask.view(-1, *(1,) * (array.dim() - 1))


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
