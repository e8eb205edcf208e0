"""MuJoCo's own window, in which the robot is steered with the arrow keys."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable

import glfw

from humoslope.deploy.gamepad import Gamepad
from humoslope.deploy.live import walk
from humoslope.deploy.player import Player
from humoslope.deploy.steering import Steering
from humoslope.errors import UserError

KEYS = "up and down: speed; left and right: turn; Enter: stand still; Home: start over"


ELSE = "look from a browser with --view browser"


class Keyboard(Steering):
    """Command entered with the keyboard."""

    def press(self, key: int) -> None:
        """Handles a key press, given as a GLFW code; keys other than `KEYS` are ignored."""
        if key in (glfw.KEY_UP, glfw.KEY_DOWN):
            self.step_speed(up=key == glfw.KEY_UP)
        elif key in (glfw.KEY_LEFT, glfw.KEY_RIGHT):
            self.step_turn(left=key == glfw.KEY_LEFT)
        elif key == glfw.KEY_ENTER:
            self.stand()
        elif key == glfw.KEY_HOME:
            self.start_over()


def check_display() -> None:
    """Checks that a window can be opened.

    Raises:
        UserError: If it cannot.
    """
    if sys.platform == "darwin" and not _under_mjpython():
        raise UserError(f"on macOS a window needs `mjpython` instead of `python`; or {ELSE}.")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # glfw's own messages; the errors below replace them
        if not glfw.init():
            raise UserError(f"there is no display to open a window on; {ELSE}.")
        # The viewer opens its window in a thread; if that failed, its caller would wait forever.
        glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
        window = glfw.create_window(64, 64, "", None, None)
        glfw.terminate()
    if not window:
        raise UserError(f"the display has no OpenGL driver for a window; {ELSE}.")


def live(player: Player, say: Callable[[str], object], gamepad: Gamepad | None = None) -> None:
    """Runs the policy in a window, in real time, until it is closed. After a fall the robot starts over.

    Args:
        player: The policy and its robot.
        say: Called with a message after each fall.
        gamepad: A gamepad that steers, too.
    """
    import mujoco.viewer

    keyboard, world = Keyboard(player.contract.commands, player.cfg.speed), player.world
    with mujoco.viewer.launch_passive(
        world.model, world.data, key_callback=keyboard.press, show_left_ui=False, show_right_ui=False
    ) as window:
        window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        window.cam.trackbodyid = world.model.body(player.contract.robot.root_body).id
        window.cam.distance, window.cam.azimuth, window.cam.elevation = 3.0, 120.0, -15.0
        walk(player, keyboard, window, say, gamepad)


def _under_mjpython() -> bool:
    import mujoco.viewer

    return mujoco.viewer._MJPYTHON is not None
