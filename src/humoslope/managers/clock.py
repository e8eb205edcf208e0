"""Durations as whole numbers of control steps, rounded once.

Subtracting a control step in float32 until nothing is left would end most durations one step late.
"""

from __future__ import annotations

from humoslope.errors import UserError


def control_steps(name: str, seconds: float, dt: float) -> int:
    """Number of control steps of `dt` s nearest to a duration.

    Args:
        name: Name of the duration, for the message.

    Raises:
        UserError: If it is not a finite duration of at least one control step.
    """
    steps = round(seconds / dt) if 0.0 < seconds < float("inf") else 0
    if steps < 1:
        raise UserError(f"{name} is {seconds:g} s; it must be finite and at least one control step of {dt:g} s.")
    return steps


def check_interval(name: str, seconds: tuple[float, float] | None, dt: float) -> tuple[float, float]:
    """Returns the shortest and the longest of a range of durations in (fractional) control steps; draws are rounded.

    Raises:
        UserError: If it is not a pair of durations of at least one control step, the shortest first.
    """
    if seconds is None or len(seconds) != 2 or not seconds[0] <= seconds[1]:
        raise UserError(f"{name} {seconds} must be two positive durations in s, the shortest first.")
    for bound in seconds:
        control_steps(name, bound, dt)
    return seconds[0] / dt, seconds[1] / dt
