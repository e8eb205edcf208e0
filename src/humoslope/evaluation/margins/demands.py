"""What is demanded of a policy that is to walk on a robot: situations, what is measured there, and bounds.

Unlike the quantities of a certificate, which are searched for their limits, these situations are fixed. The bounds are
this project's own: they say what an owner of the robot would want to see before letting it go.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Literal

from humoslope.deploy.gait import Gait
from humoslope.deploy.player import Trial, TrialCfg
from humoslope.evaluation.margins.trials import Setup, disturbances, random_tilt

Name = Literal[
    "self-contact", "stand-creep", "stand-steps", "stand-falls", "speed", "falls", "sideways", "backward", "turning",
    "manoeuvre-falls", "across-20-falls", "across-30-falls", "across-slip", "push-falls", "imu-falls", "imu-speed",
    "fast-targets", "step-rate", "knee-flexion", "double-support",
]  # fmt: skip
"""Names of the demands."""
GRADES = (-20.0, 0.0, 20.0)
GAIT = {field.name for field in fields(Gait)}


@dataclass(frozen=True)
class Case:
    """A situation.

    Attributes:
        words: The situation in words.
        setup: Course, command and conditions of all of its trials.
        imu_tilt: Tilt of the IMU about a horizontal axis that is another one in each trial, rad.
    """

    words: str
    setup: Setup
    imu_tilt: float = 0.0

    def trial(self, number: int) -> Setup:
        """Returns the setup of a trial."""
        if not self.imu_tilt:
            return self.setup
        tilt = random_tilt(self.imu_tilt, disturbances(self.setup.cfg.seed, number))
        return self.setup._replace(conditions=replace(self.setup.conditions, imu_tilt_rad=tilt))


@dataclass(frozen=True)
class Demand:
    """A figure that must lie within bounds in every one of some situations.

    Attributes:
        meaning: The figure in words.
        unit: Unit of the figure and its bounds.
        cases: The situations.
        measure: Function from the trials of a situation, and what was asked there, to the figure; NaN if it cannot be
            told, which meets no demand.
        least, most: The bounds.
    """

    meaning: str
    unit: str
    cases: tuple[Case, ...]
    measure: Callable[[Sequence[Trial], TrialCfg], float]
    least: float
    most: float

    def met(self, figure: float) -> bool:
        """Returns whether a figure lies within the bounds."""
        return self.least <= figure <= self.most

    def excess(self, figure: float) -> float:
        """Distance of a figure from the middle of the bounds, to find the worst one; infinite if it is NaN."""
        if math.isnan(figure):
            return math.inf
        if math.isinf(self.most):
            return -figure
        return figure if math.isinf(self.least) else abs(figure - 0.5 * (self.least + self.most))

    @property
    def wanted(self) -> str:
        """The bounds in words."""
        if math.isinf(self.least):
            return f"at most {self.most:g}"
        return f"at least {self.least:g}" if math.isinf(self.most) else f"{self.least:g} to {self.most:g}"


def average(name: str, factor: float = 1.0) -> Callable[[Sequence[Trial], TrialCfg], float]:
    """Measures the mean over trials of a field of `Trial` or of its gait, times `factor`."""

    def measure(trials: Sequence[Trial], cfg: TrialCfg) -> float:
        known = _known(name, trials)
        return factor * sum(known) / len(known) if known else math.nan

    return measure


def error(name: str, asked: str) -> Callable[[Sequence[Trial], TrialCfg], float]:
    """Measures how far a field of `Trial` is from the field `asked` of the command, on average over trials: errors to
    either side do not make up for each other."""

    def measure(trials: Sequence[Trial], cfg: TrialCfg) -> float:
        errors = [abs(value - getattr(cfg, asked)) for value in _known(name, trials)]
        return sum(errors) / len(errors) if errors else math.nan

    return measure


def _known(name: str, trials: Sequence[Trial]) -> list[float]:
    """Values of a field of `Trial` or of its gait that are not NaN."""
    values = [getattr(trial.gait if name in GAIT else trial, name) for trial in trials]
    return [value for value in values if not math.isnan(value)]


def falls(trials: Sequence[Trial], cfg: TrialCfg) -> float:
    """Measures the share of trials that ended in a fall, in percent."""
    return 100.0 * sum(trial.fell for trial in trials) / len(trials)


def slip(trials: Sequence[Trial], cfg: TrialCfg) -> float:
    """Measures the mean speed down a slope across the course."""
    return -math.copysign(1.0, cfg.cross) * average("lateral_speed")(trials, cfg)


def demands(seconds: float, seed: int) -> dict[Name, Demand]:
    """Returns the demands by name.

    Args:
        seconds: Length of a trial, s.
        seed: Seed of the random starts and disturbances.
    """
    usual = Setup(TrialCfg(seconds=seconds, seed=seed))

    def on(grade: float, words: str = "", **changes: float) -> Case:
        """The case of a walk on a slope, with changes of the conditions."""
        setup = Setup(replace(usual.cfg, grade=grade), replace(usual.conditions, **changes))  # type: ignore[arg-type]
        return Case(", ".join(filter(None, (f"{grade:g}°", words))), setup)

    def asked(words: str, **changes: float) -> Case:
        """The case of another command or course."""
        return Case(words, usual._replace(cfg=replace(usual.cfg, **changes)))  # type: ignore[arg-type]

    def steps(*timesteps: float) -> tuple[Case, ...]:
        return tuple(on(g, f"{1e3 * t:g} ms", timestep_s=t) for t, g in product(timesteps, GRADES))

    late = tuple(on(g, f"{1e3 * d:g} ms late", delay_s=d) for d, g in product((0.01, 0.02, 0.03), GRADES))
    strong = tuple(on(g, f"strength {s:g}", strength=s) for s, g in product((0.8, 1.2), GRADES))
    loaded = tuple(on(g, "8 kg", load_kg=8.0) for g in GRADES)
    pushed = tuple(on(g, "pushed by 1 m/s", push_m_s=1.0) for g in GRADES)
    tilted = tuple(replace(on(g, "IMU tilted by 4°"), imu_tilt=math.radians(4.0)) for g in GRADES)
    walks = (*steps(0.0005, 0.001, 0.002, 0.005, 0.01), *late, *strong, *loaded)
    stands = tuple(asked(f"{g:g}°", grade=g, speed=0.0) for g in (-20.0, -10.0, 0.0, 10.0, 20.0))
    sideways = tuple(
        asked(f"{g:g}°, {v:g} m/s", grade=g, speed=0.0, lateral=v) for g, v in product((0.0, 10.0), (0.3, -0.3))
    )
    backward = tuple(asked(f"{g:g}°", grade=g, speed=-0.3) for g in (0.0, 10.0))
    turning = tuple(asked(f"{rate:g} rad/s", yaw_rate=rate) for rate in (0.6, -0.6))
    across = {g: tuple(asked(f"{c:g}°", cross=c) for c in (g, -g)) for g in (20.0, 30.0)}
    flat, none = (on(0.0),), -math.inf
    return {
        "self-contact": Demand(
            "time in which parts of the robot touch", "%", steps(0.0005, 0.002, 0.005), average("self_contact", 100.0),
            none, 1.0,
        ),
        "stand-creep": Demand("creep when asked to stand", "m/s", stands, average("creep"), none, 0.02),
        "stand-steps": Demand("steps when asked to stand, after 2 s", "1/s", stands, average("step_rate"), none, 0.0),
        "stand-falls": Demand("falls when asked to stand", "%", stands, falls, none, 0.0),
        "speed": Demand("speed where 0.5 m/s are asked, mean over trials", "m/s", walks, average("speed"), 0.43, 0.57),
        "falls": Demand("falls where 0.5 m/s are asked", "%", walks, falls, none, 0.0),
        "sideways": Demand(
            "error of the speed sideways, mean over trials", "m/s", sideways, error("lateral_speed", "lateral"), none,
            0.1,
        ),
        "backward": Demand(
            "error of the speed backward, mean over trials", "m/s", backward, error("speed", "speed"), none, 0.1
        ),
        "turning": Demand(
            "error of the yaw rate, mean over trials", "rad/s", turning, error("yaw_rate", "yaw_rate"), none, 0.1
        ),
        "manoeuvre-falls": Demand(
            "falls sideways, backward and turning", "%", (*sideways, *backward, *turning), falls, none, 0.0
        ),
        "across-20-falls": Demand("falls across 20°", "%", across[20.0], falls, none, 0.0),
        "across-30-falls": Demand("falls across 30°", "%", across[30.0], falls, none, 5.0),
        "across-slip": Demand(
            "speed down the slope, across it", "m/s", (*across[20.0], *across[30.0]), slip, none, 0.1
        ),
        "push-falls": Demand("trials with a fall, pushed every 5 s", "%", pushed, falls, none, 10.0),
        "imu-falls": Demand("falls with a tilted IMU", "%", tilted, falls, none, 0.0),
        "imu-speed": Demand("speed with a tilted IMU, mean over trials", "m/s", tilted, average("speed"), 0.4, 0.6),
        "fast-targets": Demand(
            "variance of a joint's target above 10 Hz", "%", steps(0.001), average("fast_share", 100.0), none, 10.0
        ),
        "step-rate": Demand("steps on the flat", "1/s", flat, average("step_rate"), none, 3.0),
        "knee-flexion": Demand(
            "mean knee flexion on the flat", "°", flat, average("knee_flexion", math.degrees(1.0)), none, 35.0
        ),
        "double-support": Demand(
            "time on both feet on the flat", "%", flat, average("double_support", 100.0), 10.0, math.inf
        ),
    }  # fmt: skip
