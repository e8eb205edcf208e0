"""A window in which the robot walks in real time and obeys the arrow keys."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable

import glfw
import numpy as np

from humoslope.deploy.contract import Commands, Range
from humoslope.deploy.player import Player
from humoslope.deploy.quantities import Array
from humoslope.errors import UserError

STEP = 0.1
"""How far a key moves a command, m/s or rad/s."""
KEYS = "up and down: speed; left and right: turn; Enter: stand still; Home: start over"


class Keyboard:
    """The command that keys have asked for, within what the policy was trained for.

    Attributes:
        restart: Whether the robot is to start over; whoever does so sets it back.
    """

    def __init__(self, commands: Commands, speed: float) -> None:
        self._speeds, self._turns = (
            _rungs(commands.forward_m_s, commands.trained_to_stand),
            _rungs(commands.yaw_rate_rad_s, True),
        )
        self._stands = commands.trained_to_stand
        self._speed, self._turn = speed, 0.0
        self.restart = False

    def press(self, key: int) -> None:
        """Takes the GLFW code of a key; others than `KEYS` do nothing."""
        if key in (glfw.KEY_UP, glfw.KEY_DOWN):
            self._speed = _next(self._speeds, self._speed, up=key == glfw.KEY_UP)
        elif key in (glfw.KEY_LEFT, glfw.KEY_RIGHT):
            self._turn = _next(self._turns, self._turn, up=key == glfw.KEY_LEFT)
        elif key == glfw.KEY_ENTER and self._stands:
            self._speed = self._turn = 0.0
        elif key == glfw.KEY_HOME:
            self.restart = True

    @property
    def command(self) -> Array:
        """Forward, left, yaw rate, [3]."""
        return np.array([self._speed, 0.0, self._turn])


def check_display() -> None:
    """Raises UserError where no window can be opened."""
    if sys.platform == "darwin" and not _under_mjpython():
        raise UserError("on macOS a window needs `mjpython` instead of `python`; or add --headless.")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # glfw's own words on what fails; the sentences below say it
        if not glfw.init():
            raise UserError("there is no display to open a window on; add --headless to walk without one.")
        # The viewer opens its window in a thread, and whoever waits for it would wait for ever if that failed.
        glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
        window = glfw.create_window(64, 64, "", None, None)
        glfw.terminate()
    if not window:
        raise UserError("the display has no OpenGL driver for a window; add --headless to walk without one.")


def live(player: Player, say: Callable[[str], object]) -> None:
    """Lets the robot walk in a window, in real time, until it is closed. After a fall it starts over.

    Args:
        say: Is given a sentence on each fall.
    """
    import mujoco.viewer

    keyboard = Keyboard(player.contract.commands, player.cfg.speed)
    world, dt = player.world, player.contract.timing.control_step_s
    player.start()
    with mujoco.viewer.launch_passive(
        world.model, world.data, key_callback=keyboard.press, show_left_ui=False, show_right_ui=False
    ) as window:
        window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        window.cam.trackbodyid = world.model.body(player.contract.robot.root_body).id
        window.cam.distance, window.cam.azimuth, window.cam.elevation = 3.0, 120.0, -15.0
        due, since = time.monotonic(), 0.0
        while window.is_running():
            with window.lock():
                if world.fallen() or keyboard.restart:
                    if not keyboard.restart:
                        say(f"It fell after {since:.1f} s and starts over.")
                    player.start()
                    keyboard.restart, since = False, 0.0
                player.step(keyboard.command)
            window.sync()
            since += dt
            # A machine that cannot keep up walks slower, and does not race afterwards.
            due = max(due + dt, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))


def _rungs(limits: Range, zero: bool) -> Array:
    """The values that a key goes through."""
    low, high = limits
    rungs = np.append(np.arange(low, high - 1e-9, STEP), high)
    return np.unique(np.round(np.append(rungs, 0.0) if zero else rungs, 6))


def _next(rungs: Array, value: float, up: bool) -> float:
    further = rungs[rungs > value + 1e-9] if up else rungs[rungs < value - 1e-9][::-1]
    return float(further[0]) if len(further) else value


def _under_mjpython() -> bool:
    import mujoco.viewer

    return mujoco.viewer._MJPYTHON is not None
