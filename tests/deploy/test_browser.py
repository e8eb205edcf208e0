"""The page in the browser: what is served, what a browser receives, and what its controls ask for."""

from __future__ import annotations

import socket
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import closing
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mjviser", reason="needs the extra [view]")

import msgspec
import viser
import zstandard
from websockets.sync.client import connect

from humoslope.deploy import browser, live
from humoslope.deploy.player import Player
from humoslope.deploy.steering import Steering
from humoslope.errors import UserError

PATIENCE_S = 60


@pytest.fixture(scope="module")
def port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="module")
def player(make_player: Callable[..., Player]) -> Player:
    return make_player(grade=20.0)


@pytest.fixture(scope="module")
def steering(player: Player) -> Steering:
    return Steering(player.contract.commands, 0.5)


@pytest.fixture(scope="module")
def view(player: Player, steering: Steering, port: int) -> Iterator[browser.Page]:
    with browser.page(player, steering, port) as page:
        yield page


class Browser:
    """What a browser does with the page's socket, in viser's format: msgpack in zstd after two lengths."""

    def __init__(self, port: int) -> None:
        protocol: Any = f"viser-v{viser.__version__}"
        self.socket = connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol], max_size=None)
        self.messages: list[dict[str, Any]] = []
        camera = {"wxyz": (1, 0, 0, 0), "position": (3, 0, 1), "look_at": (0, 0, 0), "up_direction": (0, 0, 1)}
        lens = {"fov": 0.8, "near": 0.01, "far": 100.0, "image_height": 480, "image_width": 640}
        self.send(type="ViewerCameraMessage", **camera, **lens)  # only then is it taken for a browser

    def find(self, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The first wanted message of all that have come or will come."""
        until = time.monotonic() + PATIENCE_S
        while not (found := [message for message in self.messages if wanted(message)]):
            assert time.monotonic() < until, "it never came"
            frame = self.socket.recv(PATIENCE_S)
            assert isinstance(frame, bytes)
            end = 16 + int.from_bytes(frame[8:16], "little")
            content = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(frame[16:end]))
            self.messages += content["messages"]
        return found[0]

    def send(self, **message: Any) -> None:
        self.socket.send(msgspec.msgpack.encode(message))


@pytest.fixture(scope="module")
def opened(view: browser.Page, port: int) -> Iterator[Browser]:
    found = Browser(port)
    with closing(found.socket):
        yield found


def eventually(holds: Callable[[], bool]) -> bool:
    until = time.monotonic() + PATIENCE_S
    while not holds() and time.monotonic() < until:
        time.sleep(0.01)
    return holds()


def test_a_browser_gets_the_page(view: browser.Page, port: int) -> None:
    with urllib.request.urlopen(browser.address(port), timeout=PATIENCE_S) as page:
        assert b"<html" in page.read()


def test_a_browser_receives_the_robot_its_ground_and_how_they_move(
    opened: Browser, view: browser.Page, player: Player
) -> None:
    opened.find(lambda message: message["type"] == "BatchedGlbMessage" and "left_ankle_roll" in message["name"])
    opened.find(lambda message: message["type"] == "GlbMessage" and message["name"].startswith("/fixed_bodies/world"))
    opened.find(lambda message: message["type"] == "GridMessage")
    player.world.data.xpos[player.world.model.body("pelvis").id] = (3.0, 0.0, 2.0)
    view._frame_due = 0.0
    view.sync()
    opened.find(lambda message: message["type"] == "SceneNodeUpdateMessage" and "/left_ankle" in message["name"])
    ground = {"type": "SetPositionMessage", "name": "/fixed_bodies", "position": [-3.0, 0.0, -2.0]}
    opened.find(lambda message: ground.items() <= message.items())  # the camera stays with the robot


def test_sliders_and_keys_of_the_page_steer(opened: Browser, steering: Steering) -> None:
    def slider(label: str) -> str:
        kind = "GuiSliderMessage"
        return str(opened.find(lambda m: m["type"] == kind and m["props"]["label"] == label)["uuid"])

    def key(name: str) -> str:
        kind = "RegisterCommandMessage"
        return str(opened.find(lambda m: m["type"] == kind and m["props"]["hotkey"] == name)["uuid"])

    opened.send(type="GuiUpdateMessage", uuid=slider("Speed (m/s)"), updates={"value": 0.7})
    assert eventually(lambda: steering.command[0] == 0.7)
    opened.send(type="GuiUpdateMessage", uuid=slider("Turn (rad/s)"), updates={"value": -0.2})
    assert eventually(lambda: steering.command[2] == -0.2)
    opened.send(type="CommandTriggerMessage", uuid=key("I"))
    assert eventually(lambda: steering.command[0] == 0.8)
    opened.send(type="CommandTriggerMessage", uuid=key("home"))
    assert eventually(lambda: steering.restart)
    opened.send(type="CommandTriggerMessage", uuid=key("enter"))
    assert eventually(lambda: not steering.command.any())
    steering.restart = False


def test_the_page_follows_what_a_gamepad_asks_for(opened: Browser, view: browser.Page, steering: Steering) -> None:
    steering.push(1.0, 0.0)
    view._frame_due = view._status_due = 0.0
    view.sync()
    opened.find(lambda message: message["type"] == "GuiUpdateMessage" and message["updates"].get("value") == 0.8)
    assert steering.command[0] == 0.8  # and the page's own change does not come back as a wish


def test_nothing_can_be_shared_beyond_this_machine(opened: Browser) -> None:
    theme = opened.find(lambda message: message["type"] == "ThemeConfigurationMessage")
    assert theme["show_share_button"] is False


def test_a_port_in_use_is_said_in_one_sentence(
    player: Player, steering: Steering, view: browser.Page, port: int
) -> None:
    with (
        pytest.raises(UserError, match=f"port {port} cannot be used .*in use.*choose another with --port"),
        browser.page(player, steering, port),
    ):
        pass


def test_speed_is_that_over_the_last_second(
    player: Player, view: browser.Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    class World:
        data = player.world.data
        root_pos = np.zeros(3)

    monkeypatch.setattr(player, "world", World)
    view._places.clear()
    for time_s, x in ((0.0, 0.0), (1.0, 0.3), (2.0, 1.1)):
        monkeypatch.setattr(World, "data", SimpleNamespace(time=time_s))
        monkeypatch.setattr(World, "root_pos", np.array([x, 0.0, 0.0]))
        line = view._line()
    assert line.startswith("**0.80 m/s** · 20° ahead · 2 s")
    monkeypatch.setattr(World, "data", SimpleNamespace(time=0.1))
    assert view._line().startswith("**-** · 20° ahead")


def test_a_walk_on_the_page_is_a_walk(
    make_player: Callable[..., Player], port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    player, said = make_player(), list[str]()
    frames = iter([True] * 5 + [False])
    monkeypatch.setattr(browser.Page, "is_running", lambda self: next(frames))
    monkeypatch.setattr(live.time, "sleep", lambda seconds: None)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        other = int(probe.getsockname()[1])
    browser.live(player, other, said.append, None, said.append)
    assert said == [f"http://127.0.0.1:{other}"]
    assert player.world.data.time == pytest.approx(5 * 0.02)
