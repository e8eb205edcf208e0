"""The window: what keys ask for, and what is said where there is none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from types import SimpleNamespace
from typing import Any

import glfw
import mujoco.viewer
import numpy as np
import pytest

from humoslope.deploy import live, window
from humoslope.deploy.contract import Contract
from humoslope.deploy.player import Player
from humoslope.errors import UserError


def after(keyboard: window.Keyboard, *keys: int) -> list[float]:
    for key in keys:
        keyboard.press(key)
    return list(keyboard.command)


UP, DOWN, LEFT, RIGHT = glfw.KEY_UP, glfw.KEY_DOWN, glfw.KEY_LEFT, glfw.KEY_RIGHT


def test_keys_ask_for_what_was_trained_and_no_more(contract: Contract) -> None:
    keyboard = window.Keyboard(contract.commands, 0.5)
    assert after(keyboard) == [0.5, 0.0, 0.0]
    assert after(keyboard, UP) == [0.6, 0.0, 0.0]
    assert after(keyboard, *[UP] * 9) == [0.8, 0.0, 0.0]
    assert after(keyboard, *[DOWN] * 5) == [0.3, 0.0, 0.0]
    assert after(keyboard, DOWN, DOWN) == [0.0, 0.0, 0.0]  # nothing between standing and the slowest walk was trained
    assert after(keyboard, UP, LEFT) == [0.3, 0.0, 0.1]
    assert after(keyboard, *[RIGHT] * 9) == [0.3, 0.0, -0.3]
    assert after(keyboard, glfw.KEY_A) == [0.3, 0.0, -0.3]
    assert after(keyboard, glfw.KEY_ENTER) == [0.0, 0.0, 0.0]
    keyboard.press(glfw.KEY_HOME)
    assert keyboard.restart


def test_without_a_display_a_sentence_points_to_the_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(glfw, "init", lambda: False)
    with pytest.raises(
        UserError, match="there is no display to open a window on; look from a browser with --view browser"
    ):
        window.check_display()


def test_without_a_driver_a_sentence_points_to_the_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(glfw, "init", lambda: True)
    monkeypatch.setattr(glfw, "window_hint", lambda hint, value: None)
    monkeypatch.setattr(glfw, "create_window", lambda *arguments: None)
    with pytest.raises(UserError, match="the display has no OpenGL driver for a window; look from a browser"):
        window.check_display()


def test_on_a_mac_a_sentence_points_to_mjpython(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(window.sys, "platform", "darwin")
    with pytest.raises(UserError, match="on macOS a window needs `mjpython`"):
        window.check_display()


class Window:
    """A viewer's window that is closed after some frames, in which keys are pressed."""

    def __init__(self, press: Callable[[int], None], keys: dict[int, int], frames: int) -> None:
        self.press, self.keys, self.frames, self.shown = press, keys, frames, 0
        self.cam = SimpleNamespace()
        self.lock = nullcontext

    def is_running(self) -> bool:
        return self.shown < self.frames

    def sync(self) -> None:
        self.shown += 1
        if self.shown in self.keys:
            self.press(self.keys[self.shown])


def show(
    player: Player, monkeypatch: pytest.MonkeyPatch, frames: int, keys: dict[int, int]
) -> tuple[list[str], list[Any]]:
    """What is said, and the commands that were given, in a window of `frames` with `keys` pressed."""
    said: list[str] = []
    commands: list[Any] = []
    step = player.step

    @contextmanager
    def launch(model: Any, data: Any, key_callback: Any, **options: Any) -> Iterator[Window]:
        yield Window(key_callback, keys, frames)

    def watched(command: Any) -> None:
        commands.append(command)
        step(command)

    monkeypatch.setattr(mujoco.viewer, "launch_passive", launch)
    monkeypatch.setattr(live.time, "sleep", lambda seconds: None)
    monkeypatch.setattr(player, "step", watched)
    window.live(player, said.append)
    return said, commands


def test_the_robot_obeys_keys_until_the_window_is_closed(
    make_player: Callable[..., Player], monkeypatch: pytest.MonkeyPatch
) -> None:
    player = make_player()
    said, commands = show(player, monkeypatch, 12, {4: UP, 8: LEFT, 10: glfw.KEY_HOME})
    assert not said
    np.testing.assert_allclose(np.array(commands)[[0, 4, 11]], [[0.5, 0, 0], [0.6, 0, 0], [0.6, 0, 0.1]])
    assert player.world.data.time == pytest.approx(2 * 0.02)  # it started over two frames before the end


def test_after_a_fall_it_starts_over(make_player: Callable[..., Player], monkeypatch: pytest.MonkeyPatch) -> None:
    player = make_player()
    monkeypatch.setattr(player.world, "fallen", lambda: player.world.data.time > 0.0999)
    said, _ = show(player, monkeypatch, 12, {})
    assert said == ["It fell after 0.1 s and starts over."] * 2
