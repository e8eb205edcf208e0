"""Physical quantities of a certificate: their grids, and the trials that each value stands for."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from humoslope.deploy.contract import Contract
from humoslope.deploy.player import Trial, TrialCfg
from humoslope.evaluation.margins.trials import Setup, random_tilt
from humoslope.ranges import Checked, NotNegative

Name = Literal[
    "friction", "load", "delay", "strength-low", "strength-high", "encoder-bias", "imu-tilt", "push", "slope-up",
    "slope-down", "cross-slope", "yaw-rate", "speed-high", "speed-low", "timestep-fine", "timestep-coarse",
]  # fmt: skip
"""Names of the quantities."""


@dataclass(frozen=True)
class Quantity:
    """A quantity that is varied alone, from a mild value to one at which no policy is expected to succeed.

    Attributes:
        unit: Unit of the values.
        meaning: Description of the values.
        grid: Values. The first one is the nominal setup, or ground without a slope where the nominal course has one.
        setup: Function from the nominal setup, a value, the number of the trial and a generator of its own to the setup
            of that trial.
    """

    unit: str
    meaning: str
    grid: tuple[float, ...]
    setup: Callable[[Setup, float, int, np.random.Generator], Setup]


def _grid(first: float, last: float, step: float) -> tuple[float, ...]:
    count = round(abs(last - first) / step)
    return tuple(round(first + (last - first) * i / count, 9) for i in range(count + 1)) if count else (first,)


def quantities(contract: Contract, nominal: TrialCfg) -> dict[Name, Quantity]:
    """Returns the quantities for an export and its nominal course."""
    joints, control, decimation = len(contract.joints), contract.timing.control_step_s, contract.decimation
    slope = math.tan(math.radians(abs(nominal.grade)))

    def conditions(setup: Setup, **changes: object) -> Setup:
        return setup._replace(conditions=replace(setup.conditions, **changes))  # type: ignore[arg-type]

    def course(setup: Setup, **changes: object) -> Setup:
        return setup._replace(cfg=replace(setup.cfg, **changes))  # type: ignore[arg-type]

    def tilt(s: Setup, value: float, _: int, rng: np.random.Generator) -> Setup:
        return conditions(s, imu_tilt_rad=random_tilt(math.radians(value), rng))

    def bias(s: Setup, value: float, _: int, rng: np.random.Generator) -> Setup:
        return conditions(s, encoder_bias_rad=tuple(value * rng.uniform(-1.0, 1.0, joints)))

    def step(s: Setup, value: float, _: int, rng: np.random.Generator) -> Setup:
        return conditions(s, timestep_s=1e-3 * value)

    def strength(s: Setup, value: float, _: int, rng: np.random.Generator) -> Setup:
        return conditions(s, strength=value)

    def speed(s: Setup, value: float, _: int, rng: np.random.Generator) -> Setup:
        return course(s, speed=value)

    asked = nominal.speed
    return {
        "friction": Quantity(
            "1", "friction coefficient less the tangent of the grade", _grid(nominal.friction - slope, 0.05, 0.05),
            lambda s, v, _, rng: conditions(s, friction=slope + v),
        ),
        "load": Quantity(
            "kg", "mass added to the torso", _grid(0.0, 50.0, 2.0), lambda s, v, _, rng: conditions(s, load_kg=v)
        ),
        "delay": Quantity(
            "ms", "delay of joint targets, beyond the age of observations", _grid(0.0, 120.0, 5.0),
            lambda s, v, _, rng: conditions(s, delay_s=1e-3 * v),
        ),
        "strength-low": Quantity("1", "factor on all motor torques, downwards", _grid(1.0, 0.2, 0.05), strength),
        "strength-high": Quantity("1", "factor on all motor torques, upwards", _grid(1.0, 3.0, 0.1), strength),
        "encoder-bias": Quantity(
            "rad", "half-width of the random, constant offset of every encoder", _grid(0.0, 0.3, 0.01), bias
        ),
        "imu-tilt": Quantity("°", "tilt of the IMU about a random horizontal axis", _grid(0.0, 20.0, 1.0), tilt),
        "push": Quantity(
            "m/s", "speed added in a random horizontal direction every 5 s", _grid(0.0, 3.0, 0.1),
            lambda s, v, _, rng: conditions(s, push_m_s=v),
        ),
        "slope-up": Quantity(
            "°", "grade walked up", _grid(0.0, 50.0, 2.5), lambda s, v, _, rng: course(s, grade=v)
        ),
        "slope-down": Quantity(
            "°", "grade walked down", _grid(0.0, 50.0, 2.5), lambda s, v, _, rng: course(s, grade=-v)
        ),
        "cross-slope": Quantity(
            "°", "slope across the course, rising to the left and to the right in turn", _grid(0.0, 45.0, 2.5),
            lambda s, v, i, rng: course(s, grade=0.0, cross=-v if i % 2 else v),
        ),
        "yaw-rate": Quantity(
            "rad/s", "commanded yaw rate on flat ground, to the left and to the right in turn", _grid(0.0, 2.0, 0.1),
            lambda s, v, i, rng: course(s, grade=0.0, yaw_rate=-v if i % 2 else v),
        ),
        "speed-high": Quantity("m/s", "commanded speed, upwards", _grid(asked, max(3.0, 2.0 * asked), 0.1), speed),
        "speed-low": Quantity("m/s", "commanded speed, downwards", _grid(asked, min(0.1, 0.5 * asked), 0.1), speed),
        "timestep-fine": Quantity(
            "ms", "physics step, downwards; observations keep their age",
            tuple(1e3 * control / (decimation * n) for n in (1, 2, 5, 10)), step,
        ),
        "timestep-coarse": Quantity(
            "ms", "physics step, upwards; observations keep their age",
            tuple(1e3 * control / n for n in range(decimation, 0, -1)), step,
        ),
    }  # fmt: skip


@dataclass(frozen=True)
class Success(Checked):
    """Definition of a successful trial, for all quantities: no fall, and from 2 s on, on average, these errors at most.

    Attributes:
        speed_error: Largest difference from the commanded speed, along the course or, when turning, the heading, m/s.
        lateral_speed: Largest speed across a straight course, m/s.
        yaw_rate_error: Largest difference from a commanded yaw rate, rad/s.
    """

    VERB: ClassVar[str] = "margins"

    speed_error: NotNegative = 0.15
    lateral_speed: NotNegative = 0.1
    yaw_rate_error: NotNegative = 0.1

    def __call__(self, trial: Trial, cfg: TrialCfg) -> bool:
        """Returns whether the trial succeeded; NaN, "not measured", does not."""
        if trial.fell:
            return False
        if cfg.yaw_rate is not None:
            turned = abs(trial.yaw_rate - cfg.yaw_rate) <= self.yaw_rate_error
            return turned and abs(trial.heading_speed - cfg.speed) <= self.speed_error
        return abs(trial.speed - cfg.speed) <= self.speed_error and abs(trial.lateral_speed) <= self.lateral_speed

    def __str__(self) -> str:
        return (
            f"no fall; from 2 s on, speed within {self.speed_error:g} m/s of that asked, at most "
            f"{self.lateral_speed:g} m/s sideways; where it is asked to turn, along its heading and within "
            f"{self.yaw_rate_error:g} rad/s"
        )
