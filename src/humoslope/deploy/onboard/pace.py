"""The clock of a run, which may go slower where both sides are simulated."""

from __future__ import annotations

import time
from dataclasses import dataclass

from humoslope.errors import UserError

LOOPBACK = "lo"


@dataclass(frozen=True)
class Pace:
    """A clock that goes `slower` times slower than time.

    Attributes:
        slower: The factor; 1 with a real robot.
    """

    slower: float = 1.0

    def now(self) -> float:
        """The time, s; never decreasing."""
        return time.monotonic() / self.slower

    def real(self, seconds: float) -> float:
        """Returns how long `seconds` of this clock really take, s."""
        return self.slower * seconds


def pace_on(interface: str, slower: float) -> Pace:
    """Returns the clock for a network interface.

    Raises:
        UserError: If it is to go slower than a real robot.
    """
    if not 1.0 <= slower <= 100.0:
        raise UserError(f"--slower {slower:g} must be between 1 and 100.")
    if slower != 1.0 and interface != LOOPBACK:
        raise UserError(f"--slower is for a simulated robot on '{LOOPBACK}'; a real one does not wait.")
    return Pace(slower)
