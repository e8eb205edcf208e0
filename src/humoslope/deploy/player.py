"""Trials of an exported policy on one course, as in the ramp check: random starts, straight ahead, at one speed.

At speed 0 the robot is asked to stand, and the trial measures how far it creeps and how often it steps.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from humoslope.deploy.conditions import NOMINAL, Conditions
from humoslope.deploy.contract import Contract, Steering
from humoslope.deploy.controller import Controller, OnnxPolicy
from humoslope.deploy.quantities import Array
from humoslope.deploy.world import World
from humoslope.errors import UserError
from humoslope.ranges import Checked, Count, Positive, Range, Seed
from humoslope.statistics import Proportion, mean, proportion

SETTLE_S = 2.0
"""Time before speed, creep and steps count, s; the robot starts from rest, a centimetre above the ground."""
FRICTION, FRICTION_MARGIN = 0.8, 0.3
"""Smallest friction between feet and ground, and its margin over the tangent of the grade; as in the ramp check."""
ALONG, ACROSS, YAW, JOINTS = 0.15, 0.5, 0.3, 0.05
"""Half-widths of the random starts, m and rad; as in the ramp check."""
STEEPEST = 60.0
Slope = Annotated[float, Range(-STEEPEST, STEEPEST)]
"""An inclination, degrees."""
FASTEST = 10.0
SWING_S = 0.06
"""A foot that was off the ground for a shorter time, s, has not stepped: contacts of a standing foot flicker."""


@dataclass(frozen=True)
class TrialCfg(Checked):
    """Course, command and number of the trials.

    Attributes:
        grade: Grade of the ramp, degrees; negative goes down, 0 is flat ground.
        speed: Commanded forward speed, m/s; 0 asks the robot to stand.
        seconds: Length of a trial, s. A window stays open until it is closed.
        trials: Number of trials, each from another random start. More than one need --headless.
        seed: Seed of the random starts.
        cross: Slope of the ground across the course, degrees; positive rises to the left. Only without a ramp.
        yaw_rate: Commanded yaw rate, rad/s, positive to the left; null to steer along the course.
    """

    VERB: ClassVar[str] = "play"

    grade: Slope = 0.0
    speed: Annotated[float, Range(-FASTEST, FASTEST)] = 0.5
    seconds: Positive = 20.0
    trials: Count = 1
    seed: Seed = 0
    cross: Slope = 0.0
    yaw_rate: Annotated[float, Range(-FASTEST, FASTEST)] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.grade and self.cross:
            raise UserError(f"--cross {self.cross:g} and --grade {self.grade:g} cannot be combined; one must be 0.")

    @property
    def friction(self) -> float:
        """Coefficient of friction between feet and ground."""
        return max(FRICTION, math.tan(math.radians(abs(self.grade or self.cross))) + FRICTION_MARGIN)

    @property
    def length(self) -> float:
        """Length of the ramp, m: twice the commanded distance, and a reserve."""
        return 20.0 + 2.0 * abs(self.speed) * self.seconds


@dataclass(frozen=True)
class Trial:
    """Result of one trial. Positions count up to the last step before a fall.

    Attributes:
        fell: True if the trial ended in a fall.
        seconds: Duration, s.
        distance: Distance covered along the course, on its surface, m.
        speed: Mean speed along the course after `SETTLE_S`, m/s; NaN if the trial did not last that long.
        drift: Distance on the ground, in any direction, between the start and the end, m.
        creep: The same between `SETTLE_S` and the end, per second, m/s; NaN if the trial did not last that long.
        step_rate: Touchdowns of all feet per second after `SETTLE_S`, 1/s; NaN if the trial did not last that long.
        lateral_speed: Mean speed across the course after `SETTLE_S`, on its surface and to the left, m/s; NaN if the
            trial did not last that long.
        heading_speed: Mean horizontal speed in the direction of the root's heading after `SETTLE_S`, m/s; NaN if the
            trial did not last that long.
        yaw_rate: Mean yaw rate after `SETTLE_S`, rad/s; NaN if the trial did not last that long.
    """

    fell: bool
    seconds: float
    distance: float
    speed: float
    drift: float
    creep: float
    step_rate: float
    lateral_speed: float
    heading_speed: float
    yaw_rate: float


@dataclass(frozen=True)
class Summary:
    """Several trials together; None for a mean over no trial.

    Attributes:
        falls: Share of trials that ended in a fall, with Wilson's interval.
        speed: Mean of the trials' speeds, m/s.
        distance: Mean distance along the course, m.
        drift: Mean drift, m.
        creep: Mean creep, m/s.
        step_rate: Mean rate of touchdowns, 1/s.
    """

    falls: Proportion
    speed: float | None
    distance: float
    drift: float
    creep: float | None
    step_rate: float | None


class TouchdownCounter:
    """Counts touchdowns of F feet: contacts that begin after at least `SWING_S` without one.

    Args:
        feet: Number of feet F.
        dt: Time between samples, s.

    Attributes:
        count: Touchdowns so far.
    """

    def __init__(self, feet: int, dt: float) -> None:
        self._steps_off = np.zeros(feet, dtype=np.int64)  # samples since each foot was last down
        self._least = max(1, round(SWING_S / dt))
        self.count = 0

    def add(self, down: NDArray[np.bool_]) -> None:
        """Adds a sample: which feet are down, [F]."""
        self.count += int((down & (self._steps_off >= self._least)).sum())
        self._steps_off = np.where(down, 0, self._steps_off + 1)


class Player:
    """A policy, its robot, and the course below it.

    Args:
        folder: The export folder.
        contract: The contract in it.
        cfg: Course and command.
        conditions: Disturbances.
        model: MJCF of another robot with joints of the same names, in place of the export's own.

    Raises:
        UserError: If a file of the export is missing or broken, or they do not belong together.
    """

    def __init__(
        self,
        folder: Path,
        contract: Contract,
        cfg: TrialCfg,
        conditions: Conditions = NOMINAL,
        model: Path | None = None,
    ) -> None:
        self.contract, self.cfg, self.conditions = contract, cfg, conditions
        self.controller = Controller(contract, OnnxPolicy(folder, contract.network))
        self.world = World(folder, contract, cfg.grade, cfg.friction, cfg.length, cfg.cross, conditions, model)

    def start(self, rng: np.random.Generator | None = None) -> None:
        """Places the robot at the start, with a random offset of place and pose if `rng` is given."""
        self.controller.reset()
        if rng is None:
            self.world.reset()
            return
        x, y, yaw = rng.uniform(-1.0, 1.0, 3) * (ALONG, ACROSS, YAW)
        self.world.reset(x, y, yaw, rng.uniform(-JOINTS, JOINTS, len(self.contract.joints)))

    def step(self, command: Array) -> None:
        """Advances by one control step under a command [3] (forward, left, yaw rate)."""
        measured = self.world.measured(command, self.controller.last_action)
        self.world.step(self.controller(measured))

    def course_command(self) -> Array:
        """Returns the command [3] that keeps the robot on the course at its speed, or turns it at the rate of `cfg`;
        zeros if it is asked to stand."""
        if self.cfg.yaw_rate is not None:
            return np.array([self.cfg.speed, 0.0, self.cfg.yaw_rate])
        yaw_rate = steer(self.contract.commands.steering, self.world.root_pos[1], self.world.yaw)
        return np.array([self.cfg.speed, 0.0, yaw_rate]) if self.cfg.speed else np.zeros(3)

    def run_trial(self, rng: np.random.Generator) -> Trial:
        """Runs one trial from a random start."""
        self.start(rng)
        dt, world = self.contract.timing.control_step_s, self.world
        steps, settle = round(self.cfg.seconds / dt), round(SETTLE_S / dt)
        begin = settled = end = self._place()
        touchdowns, lasted = TouchdownCounter(len(world.foot_bodies), dt), steps
        headway = turned = 0.0
        push_steps = max(1, round(self.conditions.push_every_s / dt)) if self.conditions.push_m_s else steps + 1
        for done in range(1, steps + 1):
            if done > 1 and (done - 1) % push_steps == 0:
                direction = rng.uniform(-math.pi, math.pi)
                world.push(self.conditions.push_m_s * np.array([math.cos(direction), math.sin(direction), 0.0]))
            (x, y), yaw = world.root_pos[:2], world.yaw
            self.step(self.course_command())
            if world.fallen():
                lasted = done - 1
                break
            end = self._place()
            touchdowns.add(world.feet_down())
            if done <= settle:
                settled, touchdowns.count = end, 0
                continue
            headway += (world.root_pos[0] - x) * math.cos(yaw) + (world.root_pos[1] - y) * math.sin(yaw)
            turned += math.remainder(world.yaw - yaw, 2.0 * math.pi)
        fell = lasted < steps
        measured_s = (lasted - settle) * dt if lasted > settle else math.nan
        return Trial(
            fell=fell,
            seconds=(lasted + fell) * dt,
            distance=float(end[0] - begin[0]),
            speed=float(end[0] - settled[0]) / measured_s,
            drift=float(np.linalg.norm(end - begin)),
            creep=float(np.linalg.norm(end - settled)) / measured_s,
            step_rate=touchdowns.count / measured_s,
            lateral_speed=float(end[1] - settled[1]) / measured_s,
            heading_speed=headway / measured_s,
            yaw_rate=turned / measured_s,
        )

    def _place(self) -> Array:
        """Place of the root on the ground, [2] m: along the course and across it."""
        x, y, _ = self.world.root_pos
        return np.array([self.world.along(x), y / math.cos(self.world.cross)])


def steer(steering: Steering, left: float, yaw: float) -> float:
    """Returns the yaw rate, rad/s, that leads back to the course by the contract's law.

    Args:
        steering: Gains and limit of the law.
        left: Offset to the left of the course, m.
        yaw: Heading relative to the course, rad.
    """
    error = math.remainder(-steering.lateral_gain_rad_m * left - yaw, 2.0 * math.pi)
    return max(-steering.limit_rad_s, min(steering.limit_rad_s, steering.heading_gain_per_s * error))


def run_trials(player: Player) -> Iterator[Trial]:
    """Runs the trials one after the other. The random start of a trial does not depend on how many there are."""
    for trial in range(player.cfg.trials):
        yield player.run_trial(np.random.default_rng((player.cfg.seed, trial)))


def summarise(trials: Sequence[Trial]) -> Summary:
    """Returns the share of falls and the means of the trials."""

    def over(name: str) -> float | None:
        return mean(np.array([getattr(trial, name) for trial in trials]))

    return Summary(
        falls=proportion(sum(trial.fell for trial in trials), len(trials)),
        speed=over("speed"),
        distance=float(np.mean([trial.distance for trial in trials])),
        drift=float(np.mean([trial.drift for trial in trials])),
        creep=over("creep"),
        step_rate=over("step_rate"),
    )
