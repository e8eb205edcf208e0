"""A policy from outside, in the terms of its own framework but in one description."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from humoslope.deploy.contract import GaitClock, Range
from humoslope.deploy.quantities import QUANTITIES
from humoslope.errors import UserError

CONTROL_STEP_S = 0.02
"""Control step of a policy whose file does not say it, s; all of these frameworks walk at 50 Hz."""
UNBOUNDED: Range = (float("-inf"), float("inf"))


@dataclass(frozen=True)
class ForeignTerm:
    """A part of the network's input: a quantity, times a scale, within bounds.

    Attributes:
        name: Name in its framework.
        quantity: One of `humoslope.deploy.quantities`.
        scale: Factor on each component, or one for all.
        bounds: Lowest and highest value of each component after the scale, or one pair for all.
        history: Number of control steps that are observed.
    """

    name: str
    quantity: str
    scale: tuple[float, ...] = (1.0,)
    bounds: tuple[Range, ...] = (UNBOUNDED,)
    history: int = 1

    def size(self, joints: int) -> int:
        """Returns the number of components for a robot of so many joints."""
        return len(QUANTITIES[self.quantity].components) or joints

    @property
    def is_per_joint(self) -> bool:
        """True if there is one component for each joint."""
        return not QUANTITIES[self.quantity].components


@dataclass(frozen=True)
class ForeignPolicy:
    """A policy from outside. Everything over joints is in the policy's own order.

    Attributes:
        framework: Where it was trained, for people, such as "holosoma".
        joints: Names of the joints.
        stiffness: Position gains, Nm/rad.
        damping: Velocity gains, Nm s/rad.
        default: Joint targets of a zero action, rad.
        action_scale: Change of the joint target for one unit of action, rad.
        terms: Parts of the network's input in order.
        frames_together: Order of the input: all terms of the oldest control step, then all of the next one. Else all
            frames of the first term, the oldest first, then all of the next one.
        commands: Ranges of forward speed, speed to the left and yaw rate in training; None if the file does not say.
        control_step_s: Period at which the network runs.
        action_bound: Bound on the absolute value of an action; infinite for none.
        gait_clock: Clock that it sees, if it sees one.
    """

    framework: str
    joints: tuple[str, ...]
    stiffness: tuple[float, ...]
    damping: tuple[float, ...]
    default: tuple[float, ...]
    action_scale: tuple[float, ...]
    terms: tuple[ForeignTerm, ...]
    frames_together: bool = False
    commands: tuple[Range, Range, Range] | None = None
    control_step_s: float = CONTROL_STEP_S
    action_bound: float = float("inf")
    gait_clock: GaitClock | None = None

    def check(self, path: Path) -> None:
        """Raises UserError if its parts do not fit together.

        Args:
            path: File for messages.
        """
        count = len(self.joints)
        for name in ("stiffness", "damping", "default", "action_scale"):
            if (found := len(getattr(self, name))) != count:
                raise UserError(f"'{path}' has {found} numbers of {name.replace('_', ' ')} for {count} joints.")
        if len({term.name for term in self.terms}) < len(self.terms):
            raise UserError(f"'{path}' has an observation twice.")
        for term in self.terms:
            size = term.size(count)
            for what, given in (("scales", term.scale), ("bounds", term.bounds)):
                if len(given) not in (1, size):
                    raise UserError(f"'{path}': observation '{term.name}' has {len(given)} {what} for {size} numbers.")
            if term.history < 1:
                raise UserError(f"'{path}': observation '{term.name}' has a history of {term.history}.")
        if self.frames_together and len({term.history for term in self.terms}) > 1:
            raise UserError(f"'{path}': its observations have different histories, yet stand together step by step.")


def scaled(plain: ForeignTerm, scale: tuple[float, ...], clip: Range) -> ForeignTerm:
    """Returns a term with bounds that hold before the scale."""
    bounds: tuple[Range, ...] = (UNBOUNDED,)
    if clip != UNBOUNDED:
        pairs = [sorted((clip[0] * s, clip[1] * s)) for s in scale]
        bounds = tuple((low, high) for low, high in pairs)
    return ForeignTerm(plain.name, plain.quantity, scale, bounds, plain.history)


def quantity_of(name: str, known: Mapping[str, str], path: Path) -> str:
    """Returns the quantity of an observation.

    Args:
        name: Its name in the file.
        known: Quantities by the names of the framework.
        path: The file, for the message.

    Raises:
        UserError: If it is none that a contract can say.
    """
    if name not in known:
        listed = ", ".join(sorted(known))
        raise UserError(f"'{path}': its observation '{name}' is not known here; known are {listed}.")
    return known[name]


def repeated(values: Sequence[float], count: int) -> tuple[float, ...]:
    """Returns one value for each of `count` joints, of which the file may state a single one for all."""
    return tuple(values) * (count if len(values) == 1 else 1)


def numbers(values: Any, what: str, path: Path, finite: bool = True) -> tuple[float, ...]:
    """Returns values of a file as numbers.

    Args:
        values: What the file lists.
        what: Its name in the file.
        path: The file, for the message.
        finite: Refuse infinite numbers; bounds may be infinite.

    Raises:
        UserError: If one is none, or it is no list.
    """
    try:
        read = tuple(float(str(value)) for value in values)
    except (TypeError, ValueError):
        read = (math.nan,)
    if any(math.isnan(value) or (finite and math.isinf(value)) for value in read):
        raise UserError(f"'{path}': its {what} must be {'finite ' if finite else ''}numbers.")
    return read
