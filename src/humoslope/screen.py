"""Where something can be shown: windows on a display, and pages that a browser on this machine opens."""

from __future__ import annotations

import os
import socket
import sys

from humoslope.errors import UserError

HOST = "127.0.0.1"
"""Address that is listened on: only this machine can connect."""


def has_display() -> bool:
    """Returns whether windows can be opened."""
    return not sys.platform.startswith("linux") or any(os.environ.get(n) for n in ("DISPLAY", "WAYLAND_DISPLAY"))


def check_port(option: str, number: int) -> None:
    """Checks that a port can be listened on.

    Args:
        option: Name of the option that sets it, without dashes.
        number: The port.

    Raises:
        UserError: If it cannot.
    """
    if not 1 <= number <= 65535:
        raise UserError(f"--{option} is {number}; it must be between 1 and 65535.")
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, number))
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise UserError(f"port {number} cannot be used ({reason}); choose another with --{option}.") from None
