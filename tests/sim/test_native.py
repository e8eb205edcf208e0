"""What only the native backend promises."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from humoslope.cpu import usable_cores
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.registry import build_task
from humoslope.sim import make_simulation, native


def test_native_worlds_step_as_mj_step_bit_for_bit(g1_on_plane: mujoco.MjModel) -> None:
    simulation = make_simulation(g1_on_plane, 1, "native", num_threads=1)
    data = mujoco.MjData(g1_on_plane)
    data.qpos[:] = g1_on_plane.key_qpos[0]
    simulation.reset(torch.ones(1, dtype=torch.bool), torch.tensor(data.qpos)[None], torch.zeros(1, g1_on_plane.nv))
    for k in range(100):
        data.ctrl[:] = g1_on_plane.key_qpos[0, 7:] + 0.2 * np.sin(0.1 * k + np.arange(g1_on_plane.nu))
        simulation.state("ctrl").copy_(torch.tensor(data.ctrl)[None])
        mujoco.mj_step(g1_on_plane, data)
        simulation.step(1)
        assert np.array_equal(simulation.state("qpos")[0].numpy(), data.qpos)
    assert data.ncon > 0


def test_memory_too_small_for_the_contacts_is_a_sentence() -> None:
    boxes = "".join(f"<body pos='{x} 0 .09'><freejoint/><geom type='box' size='.1 .1 .1'/></body>" for x in range(30))
    ground = "<geom type='plane' size='0 0 1'/>"
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><size memory='200K'/><worldbody>{ground}{boxes}</worldbody></mujoco>"
    )
    simulation = make_simulation(model, 1, "native", num_threads=1)
    with pytest.raises(UserError, match="raise <size memory>"):
        simulation.step(1)


def test_the_number_of_threads_does_not_change_the_motion(rig: mujoco.MjModel) -> None:
    ends = []
    for threads in (1, 2):
        simulation = make_simulation(rig, 4, "native", num_threads=threads)
        simulation.state("ctrl").copy_(torch.arange(4.0)[:, None] / 4)
        simulation.step(50)
        ends.append(simulation.state("qpos").clone())
    assert torch.equal(*ends)


def test_the_number_of_threads_is_an_option_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    started, batch = [], native.mjbatch.Batch
    monkeypatch.setattr(
        native.mjbatch, "Batch", lambda model, n, threads: started.append(threads) or batch(model, n, threads)
    )
    cfg = build_task("HumoSlope-Stage1-Unitree-G1").env
    cfg.num_envs, cfg.sim.backend = 2, "native"
    for threads in (3, 0):
        cfg.sim.num_threads = threads
        ManagerBasedRlEnv(cfg)
    assert started == [3, usable_cores()]


def test_worlds_outside_the_mask_are_left_as_they_are_and_the_others_step_as_ever(rig: mujoco.MjModel) -> None:
    some, every = (make_simulation(rig, 4, "native", num_threads=2) for _ in range(2))
    chosen = torch.tensor([True, False, True, False])
    sensors = some.read("sensordata")
    for simulation in (some, every):
        simulation.state("ctrl").copy_(torch.arange(4.0)[:, None] / 4)
        simulation.step(10)
    before, seen = some.state("qpos").clone(), sensors.clone()
    some.step(20, chosen)
    every.step(20)
    assert torch.equal(some.state("qpos")[chosen], every.state("qpos")[chosen])
    assert torch.equal(some.state("qpos")[~chosen], before[~chosen])
    assert torch.equal(sensors[~chosen], seen[~chosen])
    assert some.state("time").tolist() == pytest.approx([0.15, 0.05, 0.15, 0.05])
    some.step(1, torch.zeros(4, dtype=torch.bool))
    assert torch.equal(some.state("qpos")[~chosen], before[~chosen])
