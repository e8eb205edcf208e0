"""A page in the browser on which the robot is steered with sliders and keys; drawn by mjviser and viser.

The arrow keys and W, A, S, D, Q, E move the camera in viser, so that others steer.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from typing import Any

import mujoco
import numpy as np
import viser
from mjviser import ViserMujocoScene

from humoslope.deploy.gamepad import Gamepad
from humoslope.deploy.live import walk
from humoslope.deploy.player import Player
from humoslope.deploy.steering import Steering
from humoslope.screen import HOST, check_port

KEYS = "I and K: speed; J and L: turn; Enter: stand still; Home: start over"
FRAME_S, STATUS_S = 1.0 / 30.0, 0.5
"""Time between two pictures, and between two lines about the walk, s."""
SPEED_OVER_S = 1.0
"""Time over which the speed is measured, s."""
SLIDER_STEP = 0.05
"""Step of the sliders, m/s or rad/s."""
GRID_LIFT = 2e-3
"""Height of the lines on the ground, m."""


class Page:
    """The page of a walk: a `View` that is open until the process ends.

    Args:
        server: Server of the page.
        player: The policy and its robot.
        steering: The command, which the page changes and shows.
    """

    def __init__(self, server: viser.ViserServer, player: Player, steering: Steering) -> None:
        self._player, self._steering = player, steering
        self._lock = threading.Lock()
        self._places: deque[tuple[float, np.ndarray]] = deque()
        self._frame_due = self._status_due = 0.0
        server.gui.set_panel_label("HumoSlope")
        # The page is for this machine alone; viser's button would share it through a server of others.
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._status = server.gui.add_markdown("")
        self._speed, self._turn = self._add_controls(server)
        self._scene = ViserMujocoScene(server, player.world.model, num_envs=1)
        self._scene.create_scene_gui(camera_distance=3.2, camera_azimuth=120.0, camera_elevation=12.0)
        self._scene.set_refresh_handler(self._refresh)
        _add_lines(server, player.world.model)

    def is_running(self) -> bool:
        """Always true; Ctrl-C ends the walk."""
        return True

    def lock(self) -> threading.Lock:
        """The lock under which the page reads the state of the physics."""
        return self._lock

    def sync(self) -> None:
        """Sends the present state to all browsers, if it is time for the next picture."""
        now = time.monotonic()
        if now < self._frame_due:
            return
        self._frame_due = now + FRAME_S
        self._refresh()
        if now >= self._status_due:
            self._status_due = now + STATUS_S
            self._status.content = self._line()
            speed, _, turn = self._steering.command
            self._speed.value, self._turn.value = round(float(speed), 3), round(float(turn), 3)

    def _refresh(self) -> None:
        with self._lock:
            self._scene.update_from_mjdata(self._player.world.data)

    def _line(self) -> str:
        """What is said about the walk."""
        world, cfg = self._player.world, self._player.cfg
        now, place = float(world.data.time), world.root_pos.copy()
        if self._places and now < self._places[-1][0]:  # it has started over
            self._places.clear()
        self._places.append((now, place))
        while now - self._places[0][0] > SPEED_OVER_S:
            self._places.popleft()
        before, there = self._places[0]
        speed = f"{np.linalg.norm(place - there) / (now - before):.2f} m/s" if now > before else "-"
        slope = f"{cfg.grade:g}° ahead" if cfg.grade else f"{cfg.cross:g}° across" if cfg.cross else "flat ground"
        return f"**{speed}** · {slope} · {now:.0f} s\n\n{KEYS}"

    def _add_controls(self, server: viser.ViserServer) -> list[Any]:
        steering, gui = self._steering, server.gui
        sliders: list[Any] = []  # by viser's types, their values could only be read
        for label, (low, high), value, ask in (
            ("Speed (m/s)", steering.speeds, steering.command[0], steering.ask_speed),
            ("Turn (rad/s)", steering.turns, steering.command[2], steering.ask_turn),
        ):
            # A slider without a way to go is none.
            slider: Any = gui.add_slider(
                label,
                min=low,
                max=max(high, low + SLIDER_STEP),
                step=SLIDER_STEP,
                initial_value=float(np.clip(value, low, high)),
                disabled=low == high,
            )
            slider.on_update(lambda event, ask=ask: event.client_id is not None and ask(event.target.value))
            sliders.append(slider)
        if steering.stands:
            gui.add_button("Stand still").on_click(lambda _: steering.stand())
        gui.add_button("Start over").on_click(lambda _: steering.start_over())
        keys: tuple[tuple[str, Any, Callable[[object], None]], ...] = (
            ("Faster", "I", lambda _: steering.step_speed(up=True)),
            ("Slower", "K", lambda _: steering.step_speed(up=False)),
            ("Turn left", "J", lambda _: steering.step_turn(left=True)),
            ("Turn right", "L", lambda _: steering.step_turn(left=False)),
            ("Stand still", "enter", lambda _: steering.stand()),
            ("Start over", "home", lambda _: steering.start_over()),
        )
        for label, key, press in keys:
            gui.add_command(label, hotkey=key).on_trigger(press)
        return sliders


@contextmanager
def page(player: Player, steering: Steering, port: int) -> Iterator[Page]:
    """Serves the page of a walk while the context lasts, at `address(port)`.

    Args:
        player: The policy and its robot.
        steering: The command.
        port: TCP port of the page.

    Raises:
        UserError: If the port is in use.
    """
    check_port("port", port)
    with redirect_stdout(StringIO()):  # it would print its addresses in a frame, whatever it is told
        server = viser.ViserServer(host=HOST, port=port, verbose=False)
    try:
        yield Page(server, player, steering)
    finally:
        with redirect_stdout(StringIO()):
            server.stop()


def address(port: int) -> str:
    """Address of the page."""
    return f"http://{HOST}:{port}"


def live(
    player: Player, port: int, say: Callable[[str], object], gamepad: Gamepad | None, opened: Callable[[str], object]
) -> None:
    """Runs the policy in real time on a page, until the process is interrupted. After a fall the robot starts over.

    Args:
        player: The policy and its robot.
        port: TCP port of the page.
        say: Called with a message after each fall.
        gamepad: A gamepad that steers, too.
        opened: Called with the address once the page can be looked at.

    Raises:
        UserError: If the port is in use.
    """
    steering = Steering(player.contract.commands, player.cfg.speed)
    with page(player, steering, port) as view:
        opened(address(port))
        walk(player, steering, view, say, gamepad)


def _add_lines(server: viser.ViserServer, model: mujoco.MjModel) -> None:
    """Draws a grid of metres on the slabs of a ramp, without which one would not see the robot move."""
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] or model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_BOX:
            continue
        length, width, height = model.geom_size[geom]
        quat, up = model.geom_quat[geom], np.zeros(3)
        mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, height + GRID_LIFT]), quat)
        server.scene.add_grid(
            f"/fixed_bodies/lines_{geom}",
            2.0 * length,
            2.0 * width,
            cell_size=0.5,
            section_size=1.0,
            wxyz=quat,
            position=model.geom_pos[geom] + up,
            fade_distance=30.0,
        )
