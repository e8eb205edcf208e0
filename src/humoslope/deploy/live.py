"""A walk in real time that someone watches and steers, in whatever view."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol

from humoslope.deploy.gamepad import Gamepad
from humoslope.deploy.player import Player
from humoslope.deploy.steering import Steering


class View(Protocol):
    """What shows the robot, such as the handle of MuJoCo's own window."""

    def is_running(self) -> bool:
        """False once the user has closed it."""

    def lock(self) -> AbstractContextManager[object]:
        """Keeps the view from reading the state of the physics meanwhile."""

    def sync(self) -> None:
        """Shows the present state."""


def walk(
    player: Player,
    steering: Steering,
    view: View,
    say: Callable[[str], object],
    gamepad: Gamepad | None = None,
) -> None:
    """Runs the policy in real time until the view is closed. After a fall the robot starts over.

    Args:
        player: The policy and its robot.
        steering: The command, which others change meanwhile.
        view: What shows it.
        say: Called with a message after each fall.
        gamepad: A gamepad that steers, too.
    """
    world, dt = player.world, player.contract.timing.control_step_s
    player.start()
    due, since = time.monotonic(), 0.0
    while view.is_running():
        if gamepad is not None and not gamepad.steer(steering):
            gamepad = None
            steering.push(0.0, 0.0)
            say("The gamepad is gone; the other controls go on.")
        with view.lock():
            if world.fallen() or steering.restart:
                if not steering.restart:
                    say(f"It fell after {since:.1f} s and starts over.")
                player.start()
                steering.restart, since = False, 0.0
            player.step(steering.command)
        view.sync()
        since += dt
        # On a slow machine the walk is slowed down, and does not catch up afterwards.
        due = max(due + dt, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))
