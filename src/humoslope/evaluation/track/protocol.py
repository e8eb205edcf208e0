"""The held-out protocol: every number of the benchmark, with its source."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from humoslope.errors import UserError
from humoslope.ranges import Checked, Count, Finite, NotEmpty, NotNegative, Positive, Seed, Timestep
from humoslope.terrain import course
from humoslope.terrain.course import Course

Several = Annotated[tuple[NotNegative, ...], NotEmpty()]


@dataclass(frozen=True)
class HeldOutProtocol(Checked):
    """Settings of the benchmark. Numbers are the paper's (section 4) where it gives them, others are marked "ours".

    One cell is a grade with a friction tier. Every policy gets the same starts, the same noise and the same steering:
    yaw rate = clip(0.5 (0 - heading) - 0.3 y, +-0.2) rad/s with y the metres left of the centre line, here in the terms
    of `VelocityCommandCfg`, clip(heading_gain (-lateral_gain y - heading), +-yaw_rate_limit). (The two differ only
    where heading + 0.6 y is beyond half a turn: at the edge, facing out.)

    Attributes:
        course: Name of the course.
        grades: Nominal grades, degrees.
        tiers: Friction of the feet on the ground is tan(grade) plus one of these.
        trials: Trials in each cell (ours: the paper's rates with one decimal need at least this many).
        speed: Commanded forward speed along the ground, m/s.
        success_place: Place at which a trial has succeeded, m from the start of the course; 90 % of it.
        timeout_s: Duration at which a trial has failed, s; twice the time that the whole course takes on level ground.
        heading_gain: Yaw rate per heading error, 1/s (ours).
        lateral_gain: Heading error added per metre off the centre line, rad/m (ours).
        yaw_rate_limit: Largest commanded yaw rate, rad/s (ours; within the range that Unitree RL Lab trains on).
        fall_force: Ground force on anything but feet and shins that counts as contact, N (ours).
        fall_contact_s: Duration from which such contact is a fall, s (ours).
        fall_tilt: A root that leans further from the vertical than this is a fall, degrees (ours).
        fall_com_height: A centre of mass lower over the ground than this is a fall, m (ours).
        start_place: Place of the root at the start, m from the start of the course (ours).
        start_along: Half-width of the uniform offset from it, m (ours).
        start_yaw: Half-width of the uniform heading, degrees (ours).
        start_joints: Half-width of the uniform offset of every joint from the default pose, rad (ours).
        noise: Add the noise to the actor's observations that its task was trained with (ours).
        timestep: Physics step, s; the friction cone is elliptic (ours: with a pyramidal one, a foot on 30 degrees slips
            below a friction between 0.58 and 0.81, by its direction).
        seed: Seed of starts and noise.
    """

    VERB: ClassVar[str] = "evaluate"

    course: str = "held-out-track"
    grades: Several = (0.0, 10.0, 20.0, 30.0)
    tiers: Several = (0.3, 0.6, 0.9)
    trials: Count = 128
    speed: Positive = 0.5
    success_place: Positive = 31.5
    timeout_s: Positive = 140.0
    heading_gain: Finite = 0.5
    lateral_gain: Finite = 0.6
    yaw_rate_limit: NotNegative = 0.2
    fall_force: NotNegative = 1.0
    fall_contact_s: Positive = 0.1
    fall_tilt: NotNegative = 70.0
    fall_com_height: Finite = 0.25
    start_place: NotNegative = 0.5
    start_along: NotNegative = 0.1
    start_yaw: NotNegative = 5.0
    start_joints: NotNegative = 0.05
    noise: bool = True
    timestep: Timestep = 0.005
    seed: Seed = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("grades", "tiers"):
            values = getattr(self, name)
            if len(set(values)) < len(values):
                raise UserError(f"evaluate: {name} are {list(values)}; give each once.")

    @property
    def num_cells(self) -> int:
        """Grades times tiers."""
        return len(self.grades) * len(self.tiers)

    @property
    def num_trials(self) -> int:
        """Trials in all cells."""
        return self.num_cells * self.trials

    def find_course(self) -> Course:
        """The course of this protocol.

        Raises:
            UserError: If there is no course of that name, or a grade, the start or the place of success is not on it.
        """
        found = course.find(self.course)
        found.ground(self.grades)
        if self.success_place > found.length:
            raise UserError(
                f"evaluate: success_place is {self.success_place:g} m; '{self.course}' is {found.length:g} m long."
            )
        if self.start_place >= self.success_place:
            raise UserError(
                f"evaluate: start_place is {self.start_place:g} m; it must lie before success_place, "
                f"{self.success_place:g} m."
            )
        return found

    def departures(self, from_: HeldOutProtocol) -> str:
        """Fields that differ from those of another protocol, except for the cells and the number of trials."""
        return departing(vars(self), from_)


def departing(settings: Mapping[str, Any], from_: HeldOutProtocol) -> str:
    """As `HeldOutProtocol.departures`, of fields by name; those that an older version did not have do not differ."""
    other = {name: value for name, value in vars(from_).items() if name not in ("trials", "grades", "tiers")}
    return ", ".join(f"{name} {settings[name]}" for name in other if settings.get(name, other[name]) != other[name])


SWEEP_GRADES = tuple(float(grade) for grade in range(10, 41))
"""Degrees; from well below the paper's weakest method (25) to beyond its strongest (36)."""
SWEEP_TIER = 0.6
"""The middle one."""
SWEEP_TRIALS = 32


def sweep_protocol() -> HeldOutProtocol:
    """The slope-limit sweep: the same course and rules at every degree, at the middle friction tier.

    The paper gives the result of a sweep but not its ground. A method without a success on the compound track at 30
    degrees reaches 35 in the sweep, so the paper's ground must be another one; ours is harder.
    """
    return dataclasses.replace(HeldOutProtocol(), grades=SWEEP_GRADES, tiers=(SWEEP_TIER,), trials=SWEEP_TRIALS)
