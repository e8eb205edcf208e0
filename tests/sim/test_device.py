"""The physics' device, as it would be chosen on a machine with GPUs; none is needed."""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import pytest
import torch
import warp as wp
from warp._src import context

from humoslope.errors import UserError
from humoslope.sim import make_simulation, warp
from humoslope.sim.device import describe_device, find_device


@pytest.fixture
def two_cards(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine whose torch sees two cards, the second of which is current; Warp sees them as well."""
    wp.init()
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 1)
    card = SimpleNamespace(name="Card", total_memory=80 * 2**30)
    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda device: card)
    monkeypatch.setattr(context.runtime, "cuda_devices", ["cuda:0", "cuda:1"])
    monkeypatch.setattr(wp, "get_cuda_device_count", lambda: len(context.runtime.cuda_devices))
    monkeypatch.setattr(wp, "get_cuda_driver_version", lambda: (13, 1))


@pytest.mark.parametrize(
    ("backend", "device", "expected"),
    [
        ("auto", "auto", "cuda:1"),
        ("warp", "auto", "cuda:1"),
        ("warp", "cuda", "cuda:1"),
        ("auto", "cuda:0", "cuda:0"),
        ("native", "auto", "cpu"),
        ("warp", "cpu", "cpu"),
        ("auto", "cpu:0", "cpu"),
    ],
)
def test_a_cuda_device_always_has_an_index(two_cards: None, backend: str, device: str, expected: str) -> None:
    found = find_device(backend, device)
    assert found == torch.device(expected)
    assert wp.device_from_torch(found) is not None


@pytest.mark.parametrize(
    ("backend", "device", "message"),
    [
        ("warp", "cuda:2", "'cuda:2' was asked for, but the last CUDA device is 'cuda:1'"),
        ("native", "cuda:0", "native physics runs on the CPU, not on 'cuda:0'; use backend 'warp'"),
    ],
)
def test_a_device_that_cannot_be_used_is_one_sentence(
    two_cards: None, rig: mujoco.MjModel, backend: str, device: str, message: str
) -> None:
    with pytest.raises(UserError, match=message) as error:
        make_simulation(rig, 2, backend, device)
    assert "\n" not in str(error.value)


def test_a_driver_too_old_for_warp_is_one_sentence(
    two_cards: None, rig: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(context.runtime, "cuda_devices", [])
    monkeypatch.setattr(wp, "get_cuda_driver_version", lambda: (12, 8))
    with pytest.raises(UserError, match=r"driver is for CUDA 12\.8, and MuJoCo-Warp needs one for CUDA 13\.0; update"):
        make_simulation(rig, 2)
    monkeypatch.setattr(wp, "get_cuda_driver_version", lambda: (13, 1))
    with pytest.raises(UserError, match="MuJoCo-Warp sees 0 CUDA devices"):
        make_simulation(rig, 2)


def test_the_card_is_named_before_its_kernels_are_compiled(
    two_cards: None, rig: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def start(model: mujoco.MjModel, num_worlds: int, where: torch.device, *sizes: int) -> torch.device:
        assert "cuda:1 (Card, 80 GiB, driver for CUDA 13.1)" in capsys.readouterr().err
        return where

    monkeypatch.setattr(warp, "WarpSimulation", start)
    assert make_simulation(rig, 2) == torch.device("cuda:1")


def test_the_cpu_needs_no_description() -> None:
    assert describe_device(torch.device("cpu")) == "CPU"
