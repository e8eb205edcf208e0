"""Window in which the robot walks in real time, commanded with the arrow keys."""

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
"""Change of the command by one key press, m/s or rad/s."""
KEYS = "up and down: speed; left and right: turn; Enter: stand still; Home: start over"


class Keyboard:
    """Command entered with the keyboard, within the ranges that the policy was trained with.

    Attributes:
        restart: True once a restart has been requested; to be cleared by the caller.
    """

    def __init__(self, commands: Commands, speed: float) -> None:
        self._speeds, self._turns = (
            _levels(commands.forward_m_s, commands.trained_to_stand),
            _levels(commands.yaw_rate_rad_s, True),
        )
        self._stands = commands.trained_to_stand
        self._speed, self._turn = speed, 0.0
        self.restart = False

    def press(self, key: int) -> None:
        """Handles a key press, given as a GLFW code; keys other than `KEYS` are ignored."""
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
        """Forward speed, lateral speed and yaw rate, [3]."""
        return np.array([self._speed, 0.0, self._turn])


def check_display() -> None:
    """Checks that a window can be opened.

    Raises:
        UserError: If it cannot.
    """
    if sys.platform == "darwin" and not _under_mjpython():
        raise UserError("on macOS a window needs `mjpython` instead of `python`; or add --headless.")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # glfw's own messages; the errors below replace them
        if not glfw.init():
            raise UserError("there is no display to open a window on; add --headless to walk without one.")
        # The viewer opens its window in a thread; if that failed, its caller would wait forever.
        glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
        window = glfw.create_window(64, 64, "", None, None)
        glfw.terminate()
    if not window:
        raise UserError("the display has no OpenGL driver for a window; add --headless to walk without one.")


def live(player: Player, say: Callable[[str], object]) -> None:
    """Runs the policy in a window, in real time, until it is closed. After a fall the robot starts over.

    Args:
        player: The policy and its robot.
        say: Called with a message after each fall.
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
            # On a slow machine the walk is slowed down, and does not catch up afterwards.
            due = max(due + dt, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))


def _levels(limits: Range, zero: bool) -> Array:
    """Returns the values that a key steps through."""
    low, high = limits
    levels = np.append(np.arange(low, high - 1e-9, STEP), high)
    return np.unique(np.round(np.append(levels, 0.0) if zero else levels, 6))


def _next(levels: Array, value: float, up: bool) -> float:
    further = levels[levels > value + 1e-9] if up else levels[levels < value - 1e-9][::-1]
    return float(further[0]) if len(further) else value


def _under_mjpython() -> bool:
    import mujoco.viewer

    return mujoco.viewer._MJPYTHON is not None
