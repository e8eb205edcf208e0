"""Controls that arrive late, on both backends and in plain MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from humoslope.sim import Simulation, make_simulation
from tests.sim.conftest import RIG

ROOM, DT = 6, 0.005
STEPS = torch.tensor([0, 1, 4, ROOM])
N = len(STEPS)
ALL = torch.ones(N, dtype=torch.bool)


@pytest.fixture(scope="module")
def delayed() -> mujoco.MjModel:
    """The rig, whose arm has room for a delay."""
    spec = mujoco.MjSpec.from_string(RIG)
    spec.actuators[0].nsample = ROOM
    return spec.compile()


def seconds(steps: Tensor) -> Tensor:
    return ((steps - 0.5) * DT).clamp(min=0.0)


def start(model: mujoco.MjModel, backend: str, ctrl: float = 0.0) -> Simulation:
    """One world per delay, with a control that held before."""
    simulation = make_simulation(model, N, backend, "cpu", num_threads=1)
    simulation.expand("actuator_delay").copy_(seconds(STEPS)[:, None])
    simulation.read("actuator_force")
    reset(simulation, ALL, ctrl)
    return simulation


def reset(simulation: Simulation, mask: Tensor, ctrl: float) -> None:
    qpos = torch.tensor(simulation.model.qpos0).repeat(N, 1)
    simulation.reset(mask, qpos, torch.zeros(N, simulation.model.nv), torch.full((N, 1), ctrl))


def arrivals(simulation: Simulation) -> list[int]:
    """Number of physics steps after which each world's motor feels that its target has moved by 1 rad."""
    force = simulation.read("actuator_force")
    simulation.step(1)
    before = force.clone()
    simulation.state("ctrl").add_(1.0)
    felt = torch.full((N,), -1)
    for step in range(ROOM + 2):
        simulation.step(1)
        jumped = (force - before).abs()[:, 0] > 10.0  # 30 Nm at once; the arm itself moves little in a step
        felt = torch.where((felt < 0) & jumped, step, felt)
        before = force.clone()
    return felt.tolist()


def test_a_control_arrives_after_exactly_its_number_of_steps(delayed: mujoco.MjModel, backend: str) -> None:
    assert arrivals(start(delayed, backend)) == STEPS.tolist()


def test_it_still_does_when_the_clock_has_been_rounded_for_twenty_seconds(
    delayed: mujoco.MjModel, backend: str
) -> None:
    simulation = start(delayed, backend)
    for _ in range(5):
        simulation.step(800)
        assert arrivals(simulation) == STEPS.tolist()


def test_the_control_of_a_reset_has_always_held(delayed: mujoco.MjModel, backend: str) -> None:
    simulation = start(delayed, backend)
    simulation.step(10)
    late = STEPS > 1
    reset(simulation, late, 0.5)
    force = simulation.read("actuator_force").clone()
    assert torch.allclose(force[late, 0], torch.tensor(15.0))  # kp 30 Nm/rad
    simulation.step(1)
    assert torch.allclose(simulation.read("actuator_force")[late, 0], force[late, 0], atol=0.5)


def test_every_world_moves_as_in_plain_mujoco_with_its_delay(delayed: mujoco.MjModel, backend: str) -> None:
    simulation = start(delayed, backend, ctrl=0.25)
    targets = np.sin(0.2 * np.arange(60))
    for target in targets:
        simulation.state("ctrl").fill_(target)
        simulation.step(1)
    plain = [alone(delayed, float(delay), targets) for delay in seconds(STEPS)]
    assert np.ptp([qpos[-1] for qpos in plain]) > 0.01, "a delay matters here"
    bound = 0.0 if backend == "native" else 2e-4
    assert np.abs(simulation.state("qpos").numpy() - np.array(plain)).max() <= bound


def alone(model: mujoco.MjModel, delay: float, targets: np.ndarray) -> np.ndarray:
    model.actuator_delay[0] = delay
    data = mujoco.MjData(model)
    mujoco.mj_initCtrlHistory(model, data, 0, None, np.full(ROOM, 0.25))
    for target in targets:
        data.ctrl[0] = target
        mujoco.mj_step(model, data)
    model.actuator_delay[0] = 0.0
    return data.qpos.copy()
