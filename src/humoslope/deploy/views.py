"""The views of a live walk, and the choice of one."""

from __future__ import annotations

import dataclasses
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from humoslope.deploy.gamepad import Gamepad
from humoslope.deploy.player import Player, TrialCfg
from humoslope.extras import installed, require
from humoslope.screen import has_display

Kind = Literal["browser", "window"]
Wish = Literal["auto", "browser", "window"]
PAGE = "mjviser"
"""Package that draws the page."""
LONG_S = 600.0
"""Time for which there is ground to walk on, s; who still watches then has to start over."""


@dataclasses.dataclass(frozen=True)
class Live:
    """A live walk.

    Attributes:
        view: Place where the robot is shown: a page in the browser, MuJoCo's own window, or the one that this machine
            has.
        port: TCP port of the page.
        gamepad: Device of a gamepad that steers, such as /dev/input/js0. The left stick is speed and turn, its lower
            button (A, cross) stands still, its right one (B, circle) starts over.
    """

    view: Wish = "auto"
    port: int = 8080
    gamepad: Path | None = None


def chosen(wish: Wish) -> Kind | None:
    """The view to show; None if no display is there and no view was asked for.

    Raises:
        UserError: If what draws the page that was asked for is not installed.
    """
    if wish == "browser":
        require("--view browser", PAGE)
    if wish != "auto":
        return wish
    if not has_display():
        return None
    return "browser" if installed(PAGE) else "window"


def long_course(cfg: TrialCfg) -> TrialCfg:
    """The same course, long enough for who watches and steers."""
    return dataclasses.replace(cfg, seconds=max(cfg.seconds, LONG_S))


def show(player: Player, kind: Kind, live: Live, say: Callable[[str], object], and_then: str = "") -> None:
    """Lets the robot walk in real time, steered, until its window is closed or the process is interrupted.

    Args:
        player: The policy and its robot.
        kind: The view.
        live: Port of the page, and the gamepad.
        say: Called with the address of the page, the keys, and a message after each fall.
        and_then: Said as well once the robot is shown.

    Raises:
        UserError: If there is no such display, port or gamepad.
    """
    gamepad = None if live.gamepad is None else Gamepad(live.gamepad)
    if kind == "browser":
        from humoslope.deploy import browser

        def opened(address: str) -> None:
            say(f"{address}\nIn the page, {browser.KEYS}\nCtrl-C ends it.\n{and_then}".rstrip())
            if has_display():  # otherwise Python would open a browser in the terminal
                webbrowser.open(address)

        browser.live(player, live.port, say, gamepad, opened)
        return
    from humoslope.deploy import window  # needs libraries that a machine without a display may lack

    window.check_display()
    say(f"{window.KEYS}\n{and_then}".rstrip())
    window.live(player, say, gamepad)
