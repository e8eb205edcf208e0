"""Events of a recorded walk, derived from its columns: falls with their causes, pushes, contacts of the robot with
itself, and changes of the ground."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from humoslope.evaluation.causes import SIGNALS, WINDOW_S, first_cause
from humoslope.replay.rollout import Columns, Event
from humoslope.scene.signals import CONTACT_FORCE

SETTLED = 0.3
"""Shortest time for which a change of the ground counts, s; anything shorter is a bump. Also the shortest time between
two separate contacts of the robot with itself."""

GROUND = ("level ground", "slope up", "slope down")


def falls(columns: Columns, last: bool) -> list[Event]:
    """Returns an event for each fall, after which the robot is reset.

    Args:
        columns: The walk.
        last: True if the last row is a fall too.
    """
    rows = np.flatnonzero(np.diff(columns.episode)).tolist() + ([len(columns) - 1] if last else [])
    return [Event(float(columns.time[row]), "fall", "the robot falls") for row in rows]


def causes(columns: Columns, fallen: Sequence[Event], moments: NDArray[np.floating], dt: float) -> list[Event]:
    """Returns an event for the first cause of each fall, at the moment when it began.

    Args:
        columns: The walk.
        fallen: Its falls.
        moments: [T, S] what `evaluation.causes` judges by, a row for each row of the walk.
        dt: Control step, s.
    """
    happened = []
    for fall in fallen:
        row = round(fall.time / dt) - 1
        begin = max(int(np.searchsorted(columns.episode, columns.episode[row])), row + 1 - round(WINDOW_S / dt))
        found = first_cause(dict(zip(SIGNALS, moments[begin : row + 1].T, strict=True)), dt)
        text = f"first cause: {found.cause}{', ' if found.text else ''}{found.text}"
        happened.append(Event(fall.time - found.before_s, "cause", text))
    return happened


def pushes(changes: Sequence[tuple[float, float, float]]) -> list[Event]:
    """Returns an event for each push.

    Args:
        changes: (time in s, change of velocity along world x and along world y in m/s).
    """
    return [
        Event(time, "push", f"push of {math.hypot(x, y):.2f} m/s towards {math.degrees(math.atan2(y, x)):.0f}°")
        for time, x, y in changes
    ]


def touches(columns: Columns, dt: float) -> list[Event]:
    """Returns an event for each contact of the robot with itself, with its largest force.

    Contacts less than `SETTLED` apart are one.
    """
    touching = columns.self_force > CONTACT_FORCE  # False where it is NaN
    rows = np.flatnonzero(touching)
    breaks = np.flatnonzero(np.diff(rows) * dt > SETTLED) + 1
    return [
        Event(float(columns.time[part[0]]), "touch", f"touches itself, {columns.self_force[part].max():.0f} N")
        for part in np.split(rows, breaks)
        if len(part)
    ]


def grounds(columns: Columns, dt: float) -> list[Event]:
    """Returns an event for each change between level ground and slopes of the fitted plane, with the plane's grade."""
    kind = np.where(columns.uphill, 1, np.where(columns.downhill, 2, 0))
    events, known = [], -1
    for start, end in _runs(kind):
        if kind[start] == known or (end - start) * dt < SETTLED:
            continue
        known = int(kind[start])
        grade = f" of {math.degrees(float(np.median(columns.slope[start:end]))):+.0f}°" if known else ""
        events.append(Event(float(columns.time[start]), "ground", GROUND[known] + grade))
    return events


def segments(columns: Columns, start_x: float, names: Sequence[str], ends: Sequence[float]) -> list[Event]:
    """Returns an event for each segment of a course when it is first reached after a start or fall.

    Args:
        columns: The walk.
        start_x: World x at which the course starts, m.
        names: Names of the segments.
        ends: End of each segment, m from the start of the course.
    """
    index = np.searchsorted(np.asarray(ends[:-1]), columns.root_pos_w[:, 0] - start_x, side="right")
    events, known, episode = [], -1, -1
    for row, (place, now) in enumerate(zip(index.tolist(), columns.episode.tolist(), strict=True)):
        if now == episode and place <= known:
            continue
        known, episode = place, now
        events.append(Event(float(columns.time[row]), "ground", names[place]))
    return events


def _runs(values: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Returns the first row, and the row after the last, of each stretch of equal values."""
    cuts = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return list(itertools.pairwise(cuts))
