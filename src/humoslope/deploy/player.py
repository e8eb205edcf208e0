"""Trials of a policy on one course, as in the ramp check: from random starts, straight on, at one speed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from humoslope.deploy.contract import Contract, Steering
from humoslope.deploy.controller import Controller, Policy
from humoslope.deploy.quantities import Array
from humoslope.deploy.world import World
from humoslope.errors import UserError
from humoslope.statistics import Proportion, mean, proportion

SETTLE_S = 2.0
"""Time before the speed counts, s; the robot starts from rest."""
FRICTION, FRICTION_MARGIN = 0.8, 0.3
"""Between feet and ground at least, and over the tangent of the grade; as in the ramp check."""
ALONG, ACROSS, YAW, JOINTS = 0.15, 0.5, 0.3, 0.05
"""How far a start is off its place, m and rad; as in the ramp check."""
STEEPEST = 60.0
FASTEST = 10.0


@dataclass(frozen=True)
class Course:
    """What is walked.

    Attributes:
        grade: Of the ramp, degrees; negative goes down, 0 is flat ground.
        speed: Commanded forward speed, m/s; 0 asks the robot to stand.
        seconds: Length of a trial, s. An open window stays until it is closed.
        trials: How often, each from another random start. More than one need --headless.
        seed: Of the starts.
    """

    grade: float = 0.0
    speed: float = 0.5
    seconds: float = 20.0
    trials: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        if not -STEEPEST <= self.grade <= STEEPEST:
            raise UserError(f"--grade {self.grade:g} must be between {-STEEPEST:g} and {STEEPEST:g} degrees.")
        if not abs(self.speed) <= FASTEST:
            raise UserError(f"--speed {self.speed:g} must be at most {FASTEST:g} m/s.")
        if not 0.0 < self.seconds < math.inf:
            raise UserError(f"--seconds {self.seconds:g} must be positive.")
        if self.trials < 1 or self.seed < 0:
            raise UserError(f"--trials {self.trials} must be at least 1, and --seed {self.seed} at least 0.")

    @property
    def friction(self) -> float:
        """Coefficient between feet and ground."""
        return max(FRICTION, math.tan(math.radians(abs(self.grade))) + FRICTION_MARGIN)

    @property
    def length(self) -> float:
        """Of the ramp, m: twice the way there is time for, and room to stray."""
        return 20.0 + 2.0 * abs(self.speed) * self.seconds


@dataclass(frozen=True)
class Walk:
    """How a trial went.

    Attributes:
        fell: Whether it ended in a fall.
        seconds: Until its end, s.
        distance: Along the course on its surface, m.
        speed: Mean along the course from 2 s on, m/s; NaN if it did not last so long.
    """

    fell: bool
    seconds: float
    distance: float
    speed: float


@dataclass(frozen=True)
class Outcome:
    """Several trials together: falls with Wilson's interval, means of the rest; no speed if none lasted to 2 s."""

    falls: Proportion
    speed: float | None
    distance: float


class Player:
    """A policy, its robot, and the course below it.

    Raises:
        UserError: If a file of the export is missing or broken, or they do not belong together.
    """

    def __init__(self, folder: Path, contract: Contract, course: Course) -> None:
        self.contract, self.course = contract, course
        self.controller = Controller(contract, Policy(folder, contract.network))
        self.world = World(folder, contract, course.grade, course.friction, course.length)

    def start(self, rng: np.random.Generator | None = None) -> None:
        """Puts the robot at the start; off its place and pose at random if there is an `rng`."""
        self.controller.reset()
        if rng is None:
            self.world.reset()
            return
        x, y, yaw = rng.uniform(-1.0, 1.0, 3) * (ALONG, ACROSS, YAW)
        self.world.reset(x, y, yaw, rng.uniform(-JOINTS, JOINTS, len(self.contract.joints)))

    def step(self, command: Array) -> None:
        """One control step under a command [3] (forward, left, yaw rate)."""
        measured = self.world.measured(command, self.controller.last_action)
        self.world.step(self.controller(measured))

    def straight_on(self) -> Array:
        """The command [3] that keeps the robot on the course at its speed."""
        yaw_rate = steer(self.contract.commands.steering, self.world.root_pos[1], self.world.yaw)
        return np.array([self.course.speed, 0.0, yaw_rate]) if self.course.speed else np.zeros(3)

    def walk(self, rng: np.random.Generator) -> Walk:
        """One trial."""
        self.start(rng)
        dt, world = self.contract.timing.control_step_s, self.world
        begin = world.along(world.root_pos[0])
        settled = end = begin
        steps, settle = round(self.course.seconds / dt), round(SETTLE_S / dt)
        for done in range(1, steps + 1):
            self.step(self.straight_on())
            if world.fallen():
                walked = (done - 1 - settle) * dt
                return Walk(True, done * dt, end - begin, (end - settled) / walked if walked > 0.0 else math.nan)
            end = world.along(world.root_pos[0])
            if done <= settle:
                settled = end
        speed = (end - settled) / ((steps - settle) * dt) if steps > settle else math.nan
        return Walk(False, steps * dt, end - begin, speed)


def steer(steering: Steering, left: float, yaw: float) -> float:
    """Yaw rate, rad/s, that leads back to the course, by the contract's law.

    Args:
        left: Place to the left of the course, m.
        yaw: Heading relative to the course, rad.
    """
    error = math.remainder(-steering.lateral_gain_rad_m * left - yaw, 2.0 * math.pi)
    return max(-steering.limit_rad_s, min(steering.limit_rad_s, steering.heading_gain_per_s * error))


def walks(player: Player) -> Iterator[Walk]:
    """The course's trials one after the other. Each has random numbers of its own, whatever their number."""
    for trial in range(player.course.trials):
        yield player.walk(np.random.default_rng((player.course.seed, trial)))


def outcome(done: list[Walk]) -> Outcome:
    """Trials together."""
    return Outcome(
        falls=proportion(sum(walk.fell for walk in done), len(done)),
        speed=mean(np.array([walk.speed for walk in done])),
        distance=float(np.mean([walk.distance for walk in done])),
    )
