"""A gamepad: what the kernel sends for it becomes commands, and its absence a sentence."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest

from humoslope.deploy import gamepad, live
from humoslope.deploy.contract import Contract
from humoslope.deploy.gamepad import Gamepad
from humoslope.deploy.player import Player
from humoslope.deploy.steering import Steering
from humoslope.errors import UserError

OPENING = bytes.fromhex(
    "4c3f5a0000008100 4c3f5a0000008101 4c3f5a0000008106 4c3f5a0000008107"  # buttons, let go
    "4c3f5a0000008200 4c3f5a0012018201 4c3f5a0001808202 4c3f5a0001808205"  # sticks and triggers at rest
)
"""As the kernel opens with it, in the layout of linux/joystick.h: u32 time, s16 value, u8 type, u8 number."""
FORWARD = bytes.fromhex("b8475a0001800201")  # axis 1 at -32767
HALF_LEFT = bytes.fromhex("c0475a0067b60200")  # axis 0 at -18841, half of the way beyond the dead zone
BARELY = bytes.fromhex("d0475a0030ee0201 d8475a00d0110200")  # both axes within the dead zone
LOWER, RIGHT = bytes.fromhex("304b5a0001000100"), bytes.fromhex("404b5a0001000101")
LET_GO = bytes.fromhex("384b5a0000000100")
TRIGGER = bytes.fromhex("504b5a00ff7f0205")


@pytest.fixture
def device(tmp_path: Path) -> Iterator[tuple[Path, int]]:
    """A path that is read like a device, and the end that is written to."""
    path = tmp_path / "js0"
    os.mkfifo(path)
    end = os.open(path, os.O_RDWR)
    yield path, end
    os.close(end)


@pytest.fixture
def steering(contract: Contract) -> Steering:
    return Steering(contract.commands, 0.5)


def test_recorded_bytes_steer(device: tuple[Path, int], steering: Steering) -> None:
    path, end = device
    pad = Gamepad(path)

    def after(content: bytes) -> list[float]:
        os.write(end, content)
        assert pad.steer(steering)
        return [round(value, 3) for value in steering.command]

    assert after(OPENING) == [0.5, 0.0, 0.0]  # nobody has touched it yet
    assert after(TRIGGER) == [0.5, 0.0, 0.0]
    assert after(FORWARD) == [0.8, 0.0, 0.0]
    assert after(HALF_LEFT) == [0.8, 0.0, 0.15]
    assert after(BARELY) == [0.0, 0.0, 0.0]
    assert after(FORWARD + LOWER) == [0.0, 0.0, 0.0]
    assert after(BARELY + FORWARD + LET_GO) == [0.8, 0.0, 0.0]
    assert not steering.restart
    after(RIGHT)
    assert steering.restart
    pad.close()


def test_a_resting_stick_that_jitters_leaves_keys_and_sliders_alone(
    device: tuple[Path, int], steering: Steering
) -> None:
    path, end = device
    pad = Gamepad(path)
    os.write(end, BARELY)
    assert pad.steer(steering)
    assert list(steering.command) == [0.5, 0.0, 0.0]
    pad.close()


def test_an_event_that_comes_in_pieces_is_one(device: tuple[Path, int], steering: Steering) -> None:
    path, end = device
    pad = Gamepad(path)
    for byte in FORWARD:
        os.write(end, bytes([byte]))
        assert pad.steer(steering)
    assert steering.command[0] == pytest.approx(0.8)


def test_the_dead_zone_ends_without_a_jump() -> None:
    edge = round(gamepad.DEAD_ZONE * gamepad.FULL)
    values = [gamepad._beyond_dead_zone(value) for value in (-32768, -edge - 1, -edge, 0, edge, edge + 1, 32767)]
    assert values[0] == -1.0
    assert values[-1] == 1.0
    assert values[2:5] == [0.0, 0.0, 0.0]
    assert -1e-3 < values[1] < 0.0 < values[5] < 1e-3
    assert values == sorted(values)


def test_a_gamepad_that_is_unplugged_lets_the_stick_go(
    device: tuple[Path, int], make_player: Callable[..., Player], contract: Contract, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, end = device
    pad = Gamepad(path)
    os.write(end, FORWARD)
    player = make_player()
    said: list[str] = []
    steering = Steering(contract.commands, 0.5)

    class View:
        shown = 0

        lock = nullcontext

        def is_running(self) -> bool:
            return self.shown < 4

        def sync(self) -> None:
            self.shown += 1
            if self.shown == 2:
                monkeypatch.setattr(gamepad.os, "read", gone)

    def gone(device: int, size: int) -> bytes:
        raise OSError(19, "No such device")

    monkeypatch.setattr(live.time, "sleep", lambda seconds: None)
    live.walk(player, steering, View(), said.append, pad)
    assert said == ["The gamepad is gone; the other controls go on."]
    assert list(steering.command) == [0.0, 0.0, 0.0]


def test_a_gamepad_that_is_not_there_is_named_with_those_that_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gamepad, "DEVICES", tmp_path)
    missing = tmp_path / "js7"
    with pytest.raises(UserError, match="there is no gamepad .*js7'; there are: none"):
        Gamepad(missing)
    (tmp_path / "js1").touch()
    with pytest.raises(UserError, match="there are: .*js1"):
        Gamepad(missing)
    with pytest.raises(UserError, match="js1' is no gamepad, but a file"):
        Gamepad(tmp_path / "js1")


def test_elsewhere_than_on_linux_a_sentence_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gamepad.sys, "platform", "darwin")
    with pytest.raises(UserError, match="on Linux only"):
        Gamepad(tmp_path / "js0")


def test_an_event_has_the_kernels_size() -> None:
    assert gamepad.EVENT.size == struct.calcsize("@IhBB") == 8
