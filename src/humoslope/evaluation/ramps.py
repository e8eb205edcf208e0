"""The ramp check: does a policy walk up and down planar ramps at the commanded speed, and how often does it fall?

The same for every task: a flat approach, then one planar ramp; fixed friction; small random starts; no noise on
observations, no pushes, no harness, no curriculum and no other randomisation; elliptic cone at a fine physics step.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table
from tensordict import TensorDict
from torch import Tensor

from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.errors import UserError, require_not_negative, require_positive
from humoslope.evaluation.common import measuring_physics, roll
from humoslope.evaluation.ramp_trials import Recorder, Trials
from humoslope.managers import EventTermCfg, RewardTermCfg, TerminationTermCfg, Terms
from humoslope.mdp import events, rewards, terminations
from humoslope.statistics import Array, Proportion, mean, proportion
from humoslope.terrain.grid import SPAWN_X, Tile, TileRowCfg
from humoslope.terrain.registry import Kind

APPROACH = 1.5
"""Flat ground before the ramp, m."""
SETTLE_S = 2.0
"""Time before speed and height count, s: the robot starts from rest."""
STEEPEST = 60.0
"""Largest grade, degrees."""
LONGEST = 200.0
"""Longest tile, m."""
EDGE = 0.3
"""Distance from the tile's edge at which a robot has left it, m."""
START = {"along": (-0.15, 0.15), "across": (-0.5, 0.5), "yaw": (-0.3, 0.3)}
"""Where robots start, m and rad; as wide as in training."""
START_JOINTS = {"position": (-0.05, 0.05), "velocity": (0.0, 0.0)}
"""How joints start off the default pose, rad and rad/s."""


@dataclass(frozen=True)
class RampProtocol:
    """What is measured.

    Attributes:
        grades: Of the ramps in degrees; negative goes down.
        starts: Trials on each ramp.
        speed: Commanded forward speed, m/s; every world steers straight up or down.
        seconds: Length of a trial, s.
        timestep: Physics step, s; the control step stays the task's.
        friction: Smallest coefficient between feet and ground.
        friction_margin: The coefficient is at least tan(grade) plus this.
        fall_height: A root lower over the ground than this is a fall, m; as in Stage I's training.
        fall_tilt: A root that leans further from the vertical than this is a fall, degrees; as in Stage I's training.
        seed: Of the random starts.
    """

    grades: tuple[float, ...] = (0.0, 10.0, -10.0, 20.0, -20.0, 25.0, -25.0, 30.0, -30.0)
    starts: int = 256
    speed: float = 0.5
    seconds: float = 20.0
    timestep: float = 0.005
    friction: float = 0.8
    friction_margin: float = 0.3
    fall_height: float = 0.4
    fall_tilt: float = 55.0
    seed: int = 1000

    def __post_init__(self) -> None:
        if not self.grades:
            raise UserError("ramps: there are no grades; give one or more, in degrees.")
        for grade in self.grades:
            if not -STEEPEST <= grade <= STEEPEST:
                raise UserError(f"ramps: grade {grade:g} must be between {-STEEPEST:g} and {STEEPEST:g} degrees.")
        if self.starts < 1:
            raise UserError(f"ramps: starts is {self.starts}; each ramp needs at least 1.")
        require_positive("ramps", speed=self.speed, seconds=self.seconds, timestep=self.timestep)
        require_not_negative(
            "ramps",
            friction=self.friction,
            friction_margin=self.friction_margin,
            fall_height=self.fall_height,
            fall_tilt=self.fall_tilt,
        )
        if self.tile_length > LONGEST:
            raise UserError(
                f"ramps: {self.speed:g} m/s for {self.seconds:g} s needs {self.tile_length:g} m of ground; "
                f"there are at most {LONGEST:g} m."
            )

    @property
    def tile_length(self) -> float:
        """Extent of the ground in the direction of travel, m: not even 2.5 times the speed crosses it in time."""
        return max(4.0, float(math.ceil(SPAWN_X + 2.5 * self.speed * self.seconds)))

    def friction_on(self, grade: float) -> float:
        """Coefficient of friction on a ramp of `grade` degrees."""
        return max(self.friction, math.tan(math.radians(abs(grade))) + self.friction_margin)


@dataclass(frozen=True)
class RampResult:
    """The figures of one ramp; None where no trial lasted long enough to measure them.

    Attributes:
        grade: Degrees, negative down.
        friction: Coefficient between feet and ground.
        falls: How many of the trials ended in a fall.
        left_course: Trials that ended early because the robot had walked off its tile: no fall, and no full trial.
        speed: Forward speed along the ground from 2 s on, mean of the trials' means, m/s.
        speed_error: Distance of a trial's mean speed from the commanded one, averaged over trials, m/s.
        speed_rms_error: Root mean square of the difference at each instant, m/s.
        root_height: Height of the root above the ground below it, m.
        distance: Walked along the course on its surface, m.
        seconds: Until the end of a trial, s.
    """

    grade: float
    friction: float
    falls: Proportion
    left_course: int
    speed: float | None
    speed_error: float | None
    speed_rms_error: float | None
    root_height: float | None
    distance: float
    seconds: float


def ramp_env_cfg(task_env: EnvCfg, protocol: RampProtocol) -> EnvCfg:
    """The environment of a task, stripped to what is measured: its robot, actions and actor observations on this
    protocol's ramps. Worlds are dealt out to the grades in their order, `starts` to each.

    What a fall is, is the protocol's: a task may take a robot for fallen that has only walked downhill.

    Raises:
        UserError: If the task cannot be measured so.
    """
    actor = dataclasses.replace(task_env.observations.actor, enable_corruption=False)
    friction = {"friction": (protocol.friction,) * 2, "slope_margin": protocol.friction_margin}
    sim = measuring_physics(task_env.sim, protocol.timestep, "ramps")
    return dataclasses.replace(
        task_env,
        scene=dataclasses.replace(task_env.scene, terrain=_ground(protocol)),
        sim=sim,
        num_envs=protocol.starts * len(protocol.grades),
        # The trial ends first, so that a time-out never ends an episode here.
        episode_length_s=protocol.seconds + 10.0 * sim.timestep * sim.decimation,
        seed=protocol.seed,
        command=dataclasses.replace(
            task_env.command,
            speed=(protocol.speed,) * 2,
            lateral=(0.0, 0.0),
            heading_share=1.0,
            standing_share=0.0,
        ),
        observations=Terms(actor=actor),
        rewards=Terms(alive=RewardTermCfg(rewards.alive)),  # not used; an environment must have one
        terminations=Terms(
            time_out=TerminationTermCfg(terminations.time_out, time_out=True),
            off_tile=TerminationTermCfg(terminations.off_tile, {"margin": EDGE}, time_out=True),
            root_too_low=TerminationTermCfg(terminations.root_too_low, {"height": protocol.fall_height}),
            tilted=TerminationTermCfg(terminations.tilted, {"degrees": protocol.fall_tilt}),
        ),
        events=Terms(
            friction=EventTermCfg(events.randomize_friction, friction, mode="startup"),
            root=EventTermCfg(events.ResetOnTile, START),
            joints=EventTermCfg(events.reset_joints, START_JOINTS),
        ),
        curriculum=Terms(),
    )


def _ground(protocol: RampProtocol) -> TileRowCfg:
    up, down = (Kind(name, (0.0, STEEPEST), partial(_ramp, sign=s)) for name, s in (("up", 1.0), ("down", -1.0)))
    tiles = [Tile(down if grade < 0.0 else up, abs(grade)) for grade in protocol.grades]
    return TileRowCfg(tiles, tile_length=protocol.tile_length)


def _ramp(x: Array, y: Array, grade: float, rng: np.random.Generator, sign: float) -> Array:
    """Level up to `APPROACH`, then a plane to the end of the tile."""
    return sign * math.tan(math.radians(grade)) * np.maximum(x - APPROACH, 0.0)


def along_course(x: Array, grade: float) -> Array:
    """Distance on the ground from the start of the tile to each place `x` along it, m."""
    return np.minimum(x, APPROACH) + np.maximum(x - APPROACH, 0.0) / math.cos(math.radians(grade))


def walk(
    env: ManagerBasedRlEnv,
    policy: Callable[[TensorDict], Tensor],
    protocol: RampProtocol,
    on_step: Callable[[], None] = lambda: None,
) -> Trials:
    """Lets the policy walk one trial in every world of an environment made by `ramp_env_cfg`.

    Args:
        on_step: Called after every control step.
    """
    signals, start_x = env.signals, env.tiles.origin_w[:, 0]
    settle = round(SETTLE_S / env.step_dt)
    recorder = Recorder(signals.root_pos_w[:, 0] - start_x, protocol.speed, settle, env.step_dt)

    def record(failed: Tensor, ended: Tensor) -> None:
        place = signals.root_pos_w[:, 0] - start_x
        recorder.add(place, signals.root_lin_vel_t[:, 0], signals.root_height, failed, ended)

    roll(env, policy, protocol.seconds, record, on_step)
    return recorder.trials()


def summarise(trials: Trials, protocol: RampProtocol) -> list[RampResult]:
    """The figures of every ramp, in the order of the protocol's grades."""
    results = []
    for i, grade in enumerate(protocol.grades):
        there = trials[i * protocol.starts : (i + 1) * protocol.starts]
        distance = along_course(there.end, grade) - along_course(there.start, grade)
        results.append(
            RampResult(
                grade=grade,
                friction=protocol.friction_on(grade),
                falls=proportion(int(there.fell.sum()), len(there)),
                left_course=int(there.left.sum()),
                speed=mean(there.speed),
                speed_error=there.speed_error(protocol.speed),
                speed_rms_error=there.rms_speed_error,
                root_height=mean(there.height),
                distance=float(distance.mean()),
                seconds=float(there.seconds.mean()),
            )
        )
    return results


def table(results: Sequence[RampResult]) -> Table:
    """The figures as a table, from the steepest way down to the steepest way up."""
    # Without padding a row fits into a terminal of 80 columns; a cut number is worse than a tight one.
    table = Table(title="Ramps", box=SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
    table.caption = "speed, its errors and height: from 2 s on, while the robot is up"
    for column in (
        "grade\n°",
        "\nfalls",
        "share\n%",
        "95 %\ninterval",
        "off\ncourse",
        "speed\nm/s",
        "error\nm/s",
        "RMS\nm/s",
        "height\nm",
        "way\nm",
    ):
        table.add_column(column, justify="right", no_wrap=True)
    for r in sorted(results, key=lambda r: r.grade):
        table.add_row(
            f"{r.grade:+g}" if r.grade else "0",
            f"{r.falls.count}/{r.falls.total}",
            f"{100.0 * r.falls.share:.1f}",
            f"{100.0 * r.falls.low:.1f}-{100.0 * r.falls.high:.1f}",
            str(r.left_course),
            *("-" if v is None else f"{v:.3f}" for v in (r.speed, r.speed_error, r.speed_rms_error, r.root_height)),
            f"{r.distance:.2f}",
        )
    return table
