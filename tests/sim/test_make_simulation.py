"""What a simulation refuses, and how it says so."""

from __future__ import annotations

import mujoco
import pytest
import torch

from humoslope.errors import UserError
from humoslope.sim import make_simulation

no_cuda = pytest.mark.skipif(torch.cuda.is_available(), reason="tells what happens without CUDA")


@no_cuda
def test_without_cuda_the_physics_is_native(rig: mujoco.MjModel) -> None:
    simulation = make_simulation(rig, 2, num_threads=1)
    assert (simulation.backend, simulation.device.type, simulation.num_worlds) == ("native", "cpu", 2)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"num_worlds": 0}, "number of worlds is 0"),
        ({"num_worlds": -3}, "number of worlds is -3"),
        ({"num_threads": -1}, "number of threads is -1"),
        ({"backend": "wrap"}, "did you mean 'warp'"),
        ({"backend": "native", "device": "cuda"}, "native physics runs on the CPU"),
        ({"device": "gpu"}, "not one torch knows"),
        ({"device": "meta"}, "cannot run the physics"),
        ({"backend": "warp", "device": "cpu", "njmax": 0}, "njmax is 0"),
    ],
)
def test_a_mistake_is_answered_with_one_sentence(rig: mujoco.MjModel, wrong: dict, message: str) -> None:
    with pytest.raises(UserError, match=message) as error:
        make_simulation(**{"model": rig, "num_worlds": 2, **wrong})
    assert "\n" not in str(error.value)


@no_cuda
@pytest.mark.parametrize("backend", ["auto", "warp"])
def test_cuda_that_is_not_there_is_refused(rig: mujoco.MjModel, backend: str) -> None:
    with pytest.raises(UserError, match="finds no CUDA"):
        make_simulation(rig, 2, backend, "cuda:0")


def test_a_wrong_field_name_is_answered_with_the_nearest(rig: mujoco.MjModel, backend: str) -> None:
    simulation = make_simulation(rig, 2, backend, "cpu", num_threads=1)
    with pytest.raises(UserError, match=r"reading 'sensor_data' .*'sensordata'"):
        simulation.read("sensor_data")
    with pytest.raises(UserError, match=r"state field 'qpo' .*'qpos'"):
        simulation.state("qpo")
    with pytest.raises(UserError, match=r"model field 'geom_frictions' .*'geom_friction'"):
        simulation.expand("geom_frictions")
    with pytest.raises(UserError, match="get it with state"):
        simulation.read("qpos")
    with pytest.raises(UserError, match=f"{backend} backend gives no access"):
        simulation.read("efc_force")


def test_a_reset_with_wrong_shapes_is_refused(rig: mujoco.MjModel, backend: str) -> None:
    simulation = make_simulation(rig, 2, backend, "cpu", num_threads=1)
    mask, qpos, qvel = torch.ones(2, dtype=torch.bool), torch.zeros(2, rig.nq), torch.zeros(2, rig.nv)
    for wrong in ((mask[:1], qpos, qvel), (mask, qvel, qvel), (mask.int(), qpos, qvel)):
        with pytest.raises(ValueError, match="reset takes"):
            simulation.reset(*wrong)
