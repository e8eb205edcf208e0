"""The outcome of a check."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One line of the report.

    Attributes:
        subject: Quantity that was measured.
        measured: Its value.
        wanted: Values that are right, "" where any value is.
        right: Whether the value is among them.
    """

    subject: str
    measured: str
    wanted: str = ""
    right: bool = True


def below(subject: str, value: float, limit: float, unit: str) -> Finding:
    """A finding that is right below a limit."""
    return Finding(subject, f"{value:.3g} {unit}", f"below {limit:g} {unit}", value < limit)


def at_least(subject: str, share: float, limit: float) -> Finding:
    """A finding that is right from a share upwards."""
    return Finding(subject, f"{share:.0%}", f"at least {limit:.0%}", share >= limit)
