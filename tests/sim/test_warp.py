"""The warp backend: one captured path on every device, buffers that never overflow in silence, memory that runs out."""

from __future__ import annotations

import gc
from types import SimpleNamespace

import mujoco
import mujoco_warp as mjw
import pytest
import torch
import warp as wp
from mujoco_warp import OverflowType

from humoslope.errors import UserError
from humoslope.sim import make_simulation
from humoslope.sim.warp import UNREPORTED, WarpSimulation


def start(model: mujoco.MjModel, num_worlds: int = 2, **sizes: int) -> WarpSimulation:
    simulation = make_simulation(model, num_worlds, "warp", "cpu", **sizes)
    assert isinstance(simulation, WarpSimulation)
    return simulation


@pytest.mark.parametrize(("sizes", "field"), [({"nconmax": 1}, "nconmax from 1"), ({"njmax": 5}, "njmax from 5")])
def test_a_full_buffer_is_reported_with_the_field_to_raise(
    rig: mujoco.MjModel, sizes: dict[str, int], field: str
) -> None:
    simulation = start(rig, **sizes)
    simulation.step(5)  # the box settles on its four corners
    (report,) = simulation.warnings()
    assert f"raise {field}" in report
    assert ("8 contacts at the peak" in report) or ("12 rows at the peak" in report)
    assert simulation.warnings() == []
    simulation.step(1)
    assert len(simulation.warnings()) == 1


def test_every_overflow_of_mujoco_warp_is_reported_or_left_out_on_purpose(rig: mujoco.MjModel) -> None:
    simulation = start(rig)
    for bit in OverflowType.ALL:
        wp.to_torch(simulation._d.overflow)[1] = int(bit)
        assert len(simulation.warnings()) == (0 if bit & UNREPORTED else 1), bit.name
    assert simulation.warnings() == []


def test_a_single_robot_that_lies_down_fits_in_the_buffers(g1_on_height_field: mujoco.MjModel) -> None:
    simulation = start(g1_on_height_field, 1, nconmax=8)
    qpos = torch.tensor(g1_on_height_field.key_qpos[:1], dtype=torch.float32)
    qpos[0, :7] = torch.tensor([-4.0, 0.0, 0.12, 0.5**0.5, 0.0, 0.5**0.5, 0.0])  # on its face, on level ground
    simulation.reset(torch.ones(1, dtype=torch.bool), qpos, torch.zeros(1, g1_on_height_field.nv))
    peak = 0
    for _ in range(40):
        simulation.step(1)
        peak = max(peak, int(simulation._d.nacon.numpy()[0]), int(simulation._d.ncollision.numpy()[0]))
    assert peak > 2 * 8, "far more than the average of a world"
    assert simulation.warnings() == []


def test_the_convex_buffer_holds_every_pair_a_robot_can_have_and_no_more(g1_on_height_field: mujoco.MjModel) -> None:
    model = g1_on_height_field
    simulation = start(model, 8)
    touches = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    kinds = [int((touches & (model.geom_type == kind)).sum()) for kind in range(2, 8)]
    assert simulation._d.naccdmax == 8 * max(kinds) < 8 * 16


def test_what_mujoco_warp_cannot_do_is_a_sentence() -> None:
    model = mujoco.MjModel.from_xml_string("<mujoco><option noslip_iterations='2'/></mujoco>")
    with pytest.raises(UserError, match="MuJoCo-Warp cannot run this model"):
        start(model)


def test_too_many_worlds_for_the_memory_is_a_sentence(rig: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*args: object, **kwargs: object) -> None:
        raise RuntimeError("Failed to allocate 99 bytes on device 'cuda:0'")

    simulation = start(rig)
    monkeypatch.setattr(mjw, "step", fail)  # the collider's buffers are allocated by the capture
    with pytest.raises(UserError, match="memory of cpu is too small for 2 worlds; use a smaller num_envs"):
        simulation.step(1)
    monkeypatch.setattr(mjw, "make_data", fail)
    with pytest.raises(UserError, match="memory of cpu is too small for 2 worlds"):
        start(rig)


def test_an_error_that_is_not_of_memory_goes_through(rig: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*args: object) -> None:
        raise RuntimeError("illegal address")

    simulation = start(rig)
    monkeypatch.setattr(mjw, "step", fail)
    with pytest.raises(RuntimeError, match="illegal address"):
        simulation.step(1)


def run(simulation: WarpSimulation) -> torch.Tensor:
    """Steps, changes of the model and a reset; the last qpos."""
    n, model = simulation.num_worlds, simulation.model
    for k in range(30):
        if k == 10:
            simulation.expand("geom_friction")[1, 1, 0] = 0.05
            simulation.expand("body_mass")[1] *= 2.0
            simulation.recompute_constants()
        if k == 20:
            qpos = torch.tensor(model.qpos0, dtype=torch.float32).repeat(n, 1)
            simulation.reset(torch.tensor([True, False]), qpos, torch.zeros(n, model.nv))
        simulation.state("ctrl").copy_(torch.sin(0.1 * k + torch.arange(n))[:, None])
        simulation.state("xfrc_applied")[:, model.body("box").id, 0] = 12.0
        simulation.step(2)
    return simulation.state("qpos").clone()


def test_a_captured_run_is_the_direct_run_bit_for_bit(rig: mujoco.MjModel) -> None:
    captured, direct = start(rig), start(rig)
    direct.captures = False
    assert torch.equal(run(captured), run(direct))
    assert set(captured._graphs) == {"step", "forward"}
    assert direct._graphs == {}


def test_graphs_run_on_the_simulations_device_and_are_captured_without_garbage_collection(
    rig: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulation, launched, captured = start(rig), [], []
    scopes: list[object] = []

    class Scope(wp.ScopedDevice):
        def __enter__(self) -> object:
            scopes.append(self.device)
            return super().__enter__()

        def __exit__(self, *error: object) -> None:
            scopes.pop()
            super().__exit__(*error)

    step, launch = mjw.step, wp.capture_launch
    monkeypatch.setattr(wp, "ScopedDevice", Scope)
    monkeypatch.setattr(wp, "capture_launch", lambda *a, **k: launched.append(scopes[-1]) or launch(*a, **k))
    monkeypatch.setattr(mjw, "step", lambda *a: captured.append(gc.isenabled()) or step(*a))
    simulation.step(2)
    assert launched == [simulation._wp_device] * 2
    assert captured == [False]
    assert gc.isenabled()


def test_a_card_without_memory_pools_runs_uncaptured_and_says_so_once(
    rig: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulation = start(rig)
    simulation.captures = simulation._slow_reported = False
    simulation.step(1)
    assert ["without graphs" in told for told in simulation.warnings()] == [True]
    assert simulation.warnings() == []


def test_overflows_are_read_on_torchs_stream(rig: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Warp's own stream is not ordered with one that the caller made current in torch."""
    simulation = start(rig)
    entered = []
    own = simulation._on_torch_stream
    monkeypatch.setattr(simulation, "_on_torch_stream", lambda: entered.append(True) or own())
    overflow = simulation._d.overflow
    seen = []
    guarded = SimpleNamespace(
        numpy=lambda: seen.append(bool(entered)) or overflow.numpy(),
        zero_=lambda: seen.append(bool(entered)) or overflow.zero_(),
    )
    monkeypatch.setattr(simulation._d, "overflow", guarded)
    simulation.warnings()
    assert seen == [True, True]
