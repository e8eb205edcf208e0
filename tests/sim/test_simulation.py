"""What both backends promise, on a box, a floating body and an arm."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis.strategies import floats, tuples
from torch import Tensor

from humoslope.sim import Simulation, make_simulation
from humoslope.sim.fields import STATE_FIELDS

N = 3
FLYER, ARM = "flyer", "arm"
ALL = torch.ones(N, dtype=torch.bool)
MIDDLE = torch.tensor([False, True, False])
OTHERS = ~MIDDLE
READINGS = ("sensordata", "qacc", "actuator_force", "xpos", "geom_xmat")
TOLERANCE = {"native": 1e-12, "warp": 2e-4}  # float32, over a hundred steps with contact

few_examples = settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def simulation(rig: mujoco.MjModel, backend: str) -> Simulation:
    return start(rig, backend)


def start(model: mujoco.MjModel, backend: str) -> Simulation:
    simulation = make_simulation(model, N, backend, "cpu", num_threads=1)
    simulation.reset(ALL, *initial(model, simulation))
    return simulation


def initial(model: mujoco.MjModel, simulation: Simulation) -> tuple[Tensor, Tensor]:
    dtype = simulation.state("qpos").dtype
    qpos = torch.tensor(model.qpos0, dtype=dtype).repeat(N, 1)
    return qpos, torch.zeros(N, model.nv, dtype=dtype)


def run(simulation: Simulation, steps: int) -> None:
    """Different controls in every world, the box pushed."""
    box = simulation.model.body("box").id
    for k in range(steps):
        simulation.state("ctrl").copy_(torch.sin(0.1 * k + torch.arange(N))[:, None])
        simulation.state("xfrc_applied")[:, box, 0] = 12.0
        simulation.step(1)


def test_a_reset_touches_only_the_worlds_in_its_mask(rig: mujoco.MjModel, backend: str) -> None:
    touched, untouched = start(rig, backend), start(rig, backend)
    readings = [(touched.read(field), untouched.read(field)) for field in READINGS]
    states = [(touched.state(field), untouched.state(field)) for field in STATE_FIELDS]
    for simulation in (touched, untouched):
        run(simulation, 20)
    touched.reset(MIDDLE, *initial(rig, touched))
    for mine, theirs in readings + states:
        assert torch.equal(mine[OTHERS], theirs[OTHERS])
        assert mine.shape == theirs.shape
    for array in ("ctrl", "xfrc_applied", "time"):
        assert not touched.state(array)[MIDDLE].any()
    for simulation in (touched, untouched):
        run(simulation, 20)
    for mine, theirs in readings + states:
        assert torch.equal(mine[OTHERS], theirs[OTHERS])
    assert not torch.equal(touched.state("qpos")[MIDDLE], untouched.state("qpos")[MIDDLE])


def test_a_reset_world_runs_as_if_it_were_new(rig: mujoco.MjModel, backend: str) -> None:
    used, new = start(rig, backend), start(rig, backend)
    run(used, 30)
    used.reset(ALL, *initial(rig, used))
    for simulation in (used, new):
        run(simulation, 20)
    assert torch.equal(used.state("qpos"), new.state("qpos"))


def test_a_reset_of_no_world_changes_nothing(simulation: Simulation) -> None:
    sensors = simulation.read("sensordata")
    run(simulation, 5)
    before = sensors.clone(), simulation.state("qpos").clone()
    simulation.reset(torch.zeros(N, dtype=torch.bool), *initial(simulation.model, simulation))
    assert torch.equal(sensors, before[0])
    assert torch.equal(simulation.state("qpos"), before[1])


@few_examples
@given(angle=floats(-1.5, 1.5), speed=floats(-2, 2), depth=floats(0, 0.004), held=floats(-1, 1), lift=floats(-5, 5))
def test_readings_after_a_reset_are_those_of_mj_forward_under_the_controls_and_wrenches_that_are_given(
    simulation: Simulation, angle: float, speed: float, depth: float, held: float, lift: float
) -> None:
    model = simulation.model
    readings = {field: simulation.read(field) for field in READINGS}
    qpos, qvel = initial(model, simulation)
    qpos[:, 2] -= depth
    qpos[:, -1], qvel[:, -1] = angle, speed
    ctrl, wrench = torch.full((N, model.nu), held), torch.zeros(N, model.nbody, 6)
    wrench[:, model.body("box").id, 2] = lift
    simulation.reset(ALL, qpos, qvel, ctrl, wrench)
    data = mujoco.MjData(model)
    data.qpos, data.qvel, data.ctrl, data.xfrc_applied = (x[0].numpy() for x in (qpos, qvel, ctrl, wrench))
    mujoco.mj_forward(model, data)
    for field, reading in readings.items():
        expected = torch.tensor(getattr(data, field)).float()
        assert reading.shape == (N, *expected.shape)
        assert torch.allclose(reading, expected.expand_as(reading), rtol=1e-3, atol=2e-3), field


def test_readings_after_a_step_are_of_the_instant_before_it(simulation: Simulation) -> None:
    sensors = simulation.read("sensordata")
    arm = simulation.model.sensor(1).adr[0]
    run(simulation, 10)
    before = simulation.state("qpos")[:, -1].clone()
    simulation.step(1)
    assert torch.allclose(sensors[:, arm], before.float())
    assert (simulation.state("qpos")[:, -1] - before).abs().max() > 1e-4


force = floats(-50, 50)


@few_examples
@given(forces=tuples(force, force, force))
def test_a_wrench_accelerates_a_free_body_by_newtons_law(simulation: Simulation, forces: tuple[float, ...]) -> None:
    model = simulation.model
    body, dof = model.body(FLYER).id, model.jnt_dofadr[model.body(FLYER).jntadr[0]]
    simulation.reset(ALL, *initial(model, simulation))
    simulation.state("xfrc_applied")[:, body, 2] = torch.tensor(forces, dtype=simulation.state("qpos").dtype)
    simulation.step(20)
    expected = torch.tensor(forces) / 4.0 * 20 * model.opt.timestep  # 4 kg, weightless
    assert torch.allclose(simulation.state("qvel")[:, dof + 2].float(), expected, rtol=1e-4, atol=1e-4)
    assert not simulation.state("qvel")[:, dof : dof + 2].abs().gt(1e-5).any()


def slippery(model: mujoco.MjModel | Simulation) -> None:
    values(model, "geom_friction", "geom", "box")[..., 0] = 0.1


def heavy(model: mujoco.MjModel | Simulation) -> None:
    values(model, "body_mass", "body", ARM)[...] *= 2.0
    values(model, "body_inertia", "body", ARM)[...] *= 2.0


def shifted(model: mujoco.MjModel | Simulation) -> None:
    values(model, "body_ipos", "body", ARM)[..., 0] += 0.1


def stiff(model: mujoco.MjModel | Simulation) -> None:
    values(model, "actuator_gainprm", "actuator", ARM)[..., 0] = 60.0
    values(model, "actuator_biasprm", "actuator", ARM)[..., 1] = -60.0
    values(model, "actuator_biasprm", "actuator", ARM)[..., 2] = -1.0


def values(model: mujoco.MjModel | Simulation, field: str, kind: str, name: str) -> np.ndarray | Tensor:
    """The field of one named element: in the model, or in the middle world of a simulation."""
    if isinstance(model, mujoco.MjModel):
        return getattr(model, field)[getattr(model, kind)(name).id, ...]
    return model.expand(field)[1, getattr(model.model, kind)(name).id]


@pytest.mark.parametrize("change", [slippery, heavy, shifted, stiff], ids=lambda change: change.__name__)
def test_a_changed_world_moves_as_a_single_world_with_that_model(
    rig: mujoco.MjModel, backend: str, change: Callable[[mujoco.MjModel | Simulation], None]
) -> None:
    simulation = start(rig, backend)
    change(simulation)
    simulation.recompute_constants()
    changed = copy(rig)
    change(changed)
    mujoco.mj_setConst(changed, mujoco.MjData(changed))

    box = rig.body("box").id
    simulation.state("ctrl").fill_(0.5)
    simulation.state("xfrc_applied")[:, box, 0] = 12.0
    simulation.step(100)
    expected = []
    for model in (rig, changed, rig):
        data = mujoco.MjData(model)
        data.ctrl[:] = 0.5
        data.xfrc_applied[box, 0] = 12.0
        for _ in range(100):
            mujoco.mj_step(model, data)
        expected.append(data.qpos.copy())
    error = np.abs(simulation.state("qpos").numpy() - np.array(expected)).max()
    assert error < TOLERANCE[backend]
    assert np.abs(expected[1] - expected[0]).max() > 0.01


def test_recomputed_constants_are_those_of_the_changed_model(rig: mujoco.MjModel, backend: str) -> None:
    simulation = start(rig, backend)
    heavy(simulation)
    simulation.recompute_constants()
    changed = copy(rig)
    heavy(changed)
    mujoco.mj_setConst(changed, mujoco.MjData(changed))
    for field in ("body_subtreemass", "body_invweight0", "dof_invweight0", "actuator_acc0"):
        expected = np.stack([getattr(model, field) for model in (rig, changed, rig)])
        assert np.allclose(simulation.expand(field).numpy(), expected, rtol=1e-4), field


def test_moving_a_centre_of_mass_leaves_the_shapes_where_they_are(rig: mujoco.MjModel, backend: str) -> None:
    simulation = start(rig, backend)
    shapes, centres = simulation.read("geom_xpos"), simulation.read("xipos")
    shifted(simulation)
    simulation.recompute_constants()
    simulation.reset(ALL, *initial(rig, simulation))
    assert torch.equal(shapes[0], shapes[1])
    assert torch.allclose(centres[1, -1] - centres[0, -1], torch.tensor([0.1, 0.0, 0.0]), atol=1e-6)


@pytest.mark.parametrize("field", ["qpos", "qvel", "ctrl"])
def test_a_diverged_world_is_seen_and_the_others_go_on(
    rig: mujoco.MjModel, backend: str, field: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings to a file in the working directory
    broken, whole = start(rig, backend), start(rig, backend)
    for simulation in (broken, whole):
        run(simulation, 5)
    assert not broken.diverged().any()
    broken.state(field)[1, -1] = torch.nan
    for simulation in (broken, whole):
        simulation.step(2)
    assert broken.diverged().tolist() == MIDDLE.tolist()
    assert not whole.diverged().any()
    assert torch.equal(broken.state("qpos")[OTHERS], whole.state("qpos")[OTHERS])

    for simulation in (broken, whole):
        simulation.reset(MIDDLE, *initial(rig, simulation))
    assert not broken.diverged().any()
    for simulation in (broken, whole):
        run(simulation, 5)
    assert torch.equal(broken.state("qpos"), whole.state("qpos"))
    assert broken.warnings() == []


@pytest.mark.parametrize(("speed", "broken"), [(5e3, True), (500.0, False)])
def test_a_world_that_explodes_counts_as_diverged_while_its_numbers_are_finite(
    rig: mujoco.MjModel, backend: str, speed: float, broken: bool
) -> None:
    simulation = start(rig, backend)
    simulation.state("qvel")[1, -1] = speed  # rad/s
    simulation.step(1)
    assert simulation.state("qvel").isfinite().all()
    assert simulation.diverged().tolist() == [False, broken, False]


def test_a_model_field_may_be_given_to_each_world_in_the_middle_of_a_run(rig: mujoco.MjModel, backend: str) -> None:
    changed, plain = start(rig, backend), start(rig, backend)
    for simulation in (changed, plain):
        run(simulation, 5)
    slippery(changed)
    for simulation in (changed, plain):
        run(simulation, 40)
    assert torch.equal(changed.state("qpos")[OTHERS], plain.state("qpos")[OTHERS])
    assert (changed.state("qpos") - plain.state("qpos"))[1].abs().max() > 1e-3


def test_the_known_rows_hold_every_world_of_the_mask_and_where_looking_costs_nothing_no_other(
    rig: mujoco.MjModel, backend: str
) -> None:
    simulation = start(rig, backend)
    for mask in (MIDDLE, ALL, ~ALL):
        rows = torch.arange(N)[simulation.known_rows(mask)]
        assert set(mask.nonzero().squeeze(1).tolist()) <= set(rows.tolist())
        assert backend == "warp" or len(rows) == mask.sum()
        assert not simulation.known_empty(mask) or not mask.any()
