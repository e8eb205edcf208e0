"""A second process that damps the robot when the first one dies or hangs: nobody else would tell the motors.

Once the first process has commanded the motors it sends a byte every control step. When these stop without a farewell,
the guardian ends the process, whose network thread might go on repeating its last command, and damps the robot itself.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

from humoslope.deploy import contract as contracts
from humoslope.deploy.onboard import states
from humoslope.deploy.onboard.pace import Pace
from humoslope.deploy.onboard.unitree_link import UnitreeLink
from humoslope.errors import UserError

BEAT, FAREWELL, READY = b".", b"q", b"r"
PATIENCE_S = 0.1
"""Longest time between two bytes, s, unless the ward is more patient with itself."""
DAMPED_S = 2.0
"""Time for which the guardian repeats the command, s; the robot keeps the last one."""
START_S = 20.0
"""Longest time for the guardian to be ready, s."""


class Guardian:
    """The guardian as its ward sees it.

    Args:
        folder: The export folder.
        interface: Name of the network interface.
        tag: See `unitree_link.open_interface`.
        pace: The clock.
        missed_s: Time without a command for which the ward itself waits, s. The guardian is never less patient.

    Raises:
        UserError: If the guardian does not start.
    """

    def __init__(self, folder: Path, interface: str, tag: str, pace: Pace, missed_s: float = 0.0) -> None:
        patience_s = pace.real(max(PATIENCE_S, missed_s))
        arguments = [str(folder), interface, tag, str(os.getpid()), str(patience_s)]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "humoslope.deploy.onboard.guardian", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for its ward
        )
        assert self._process.stdout is not None
        ready, _, _ = select.select([self._process.stdout], [], [], START_S)
        if not ready or os.read(self._process.stdout.fileno(), 1) != READY:
            self._process.kill()
            raise UserError("the guardian, a second process that damps the robot if this one dies, did not start.")

    def beat(self) -> bool:
        """Says that all is well; returns whether the guardian is there to hear it. From then on silence is a fault."""
        return self._send(BEAT)

    def alive(self) -> bool:
        """Returns whether the guardian is there, and tells it nothing."""
        return self._process.poll() is None

    def dismiss(self) -> None:
        """Ends the guardian, whose ward has damped the robot itself."""
        self._send(FAREWELL)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=5.0)

    def _send(self, byte: bytes) -> bool:
        assert self._process.stdin is not None
        try:
            os.write(self._process.stdin.fileno(), byte)
        except OSError:
            return False
        return self.alive()


def guard(folder: Path, interface: str, tag: str, ward: int, patience_s: float) -> None:
    """Waits for the bytes of the ward, a process id; damps the robot when they stop for `patience_s`."""
    contract = contracts.read(folder)
    out = os.dup(1)
    os.dup2(2, 1)  # the SDK writes to the standard output
    link = UnitreeLink(contract, interface, tag)
    os.write(out, READY)
    if os.read(0, 1) in (b"", FAREWELL):
        return  # its ward ended before it began
    while True:
        heard, _, _ = select.select([0], [], [], patience_s)
        byte = os.read(0, 64) if heard else b""
        if FAREWELL in byte:
            return
        if not byte:
            break
    with contextlib.suppress(ProcessLookupError):
        os.kill(ward, signal.SIGKILL)
    end = time.monotonic() + DAMPED_S
    while time.monotonic() < end:
        link.write(states.damping(contract))
        time.sleep(0.02)
    print("humoslope: the program that moved the robot has died or hung; the robot was damped.", file=sys.stderr)


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    guard(Path(sys.argv[1]), sys.argv[2], sys.argv[3], int(sys.argv[4]), float(sys.argv[5]))
    os._exit(0)  # the SDK's threads need no farewell
