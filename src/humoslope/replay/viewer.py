"""Opening a recording in rerun's viewer, in a window or in a browser."""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import sys
import webbrowser
from collections.abc import Callable
from pathlib import Path

from humoslope.errors import UserError

HERE = "127.0.0.1"
"""Only this machine can see what is served."""
INTERRUPTED = 130, -2


def open_window(path: Path) -> None:
    """Shows a recording in a window, until it is closed.

    Raises:
        UserError: If there is no display, or the viewer could not run on this machine.
    """
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise UserError(
            "there is no display; use --web to look from a browser, --save FILE.rrd to look elsewhere, "
            "or `humoslope video`."
        )
    _run([str(path), "--new", "--bind", HERE])


def serve(path: Path, web_port: int, port: int, announce: Callable[[str], None]) -> None:
    """Serves a recording to browsers on this machine, until it is interrupted.

    Args:
        web_port: Where the page is.
        port: Where its data is.
        announce: Called with the page's address once it can be opened.

    Raises:
        UserError: If a port is in use.
    """
    for option, number in (("web-port", web_port), ("port", port)):
        check_port(option, number)
    command = [str(path), "--serve-web", "--bind", HERE, "--web-viewer-port", str(web_port), "--port", str(port)]
    ...


def check_port(option: str, number: int) -> None:
    """Says that a port cannot be listened on before the viewer is started.

    Raises:
        UserError: If so.
    """
    if not 1 <= number <= 65535:
        raise UserError(f"--{option} {number} must be between 1 and 65535.")
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HERE, number))
        except OSError as error:
            raise UserError(f"port {number} cannot be used ({error.strerror}); choose another with --{option}.") from None
