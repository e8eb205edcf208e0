"""The ramp check: speed and falls of a policy that walks up and down planar ramps, or stands on them.

It is the same for every task: a flat approach, then one planar ramp; fixed friction; small random starts; elliptic cone
at a fine physics step; no observation noise, harness, curriculum or randomisation, and no pushes unless asked for. With
a commanded speed of zero the robot starts on the slope, is commanded to stand, and its creep and its steps are
measured. Commanded to walk backward, to a side or across the slope, or to turn, it starts on the slope too.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table
from tensordict import TensorDict
from torch import Tensor

from humoslope.deploy.gait import FOOT_DOWN_N, STEP
from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.evaluation.common import measuring_physics, policy_observations, rollout
from humoslope.evaluation.ramp_trials import Recorder, Trials
from humoslope.managers import EventTermCfg, TerminationTermCfg, Terms
from humoslope.mdp import events, terminations
from humoslope.ranges import Checked, Count, Finite, NotEmpty, NotNegative, Positive, Range, Seed, Timestep
from humoslope.scene.signals import CONTACT_FORCE
from humoslope.statistics import Array, Proportion, mean, proportion
from humoslope.terrain.grid import SPAWN_X, Tile, TileRowCfg
from humoslope.terrain.registry import Kind

APPROACH = 1.5
"""Flat ground before the ramp, m."""
SETTLE_S = 2.0
"""Time before averages begin, s: the robot starts from rest."""
STEEPEST = 60.0
"""Largest grade, degrees."""
LONGEST = 200.0
"""Longest and widest tile, m."""
WIDTH = 5.0
"""Width of a tile whose centre line the robot keeps to, m."""
EDGE = 0.3
"""Distance from the tile's edge at which a robot has left it, m."""
ALONG, ACROSS, YAW = 0.15, 0.5, 0.3
"""Half-widths of the random start, m, m and rad; as in training."""
START_JOINTS = {"position": (-0.05, 0.05), "velocity": (0.0, 0.0)}
"""Random offsets of joints from the default pose, rad and rad/s."""
Grades = Annotated[tuple[Annotated[float, Range(-STEEPEST, STEEPEST)], ...], NotEmpty()]
CREEP = 0.5
"""Speed at which a robot that drifts in a direction that is not commanded stays on its tile for the trial, m/s."""


@dataclass(frozen=True)
class RampProtocol(Checked):
    """Settings of the ramp check.

    Attributes:
        grades: Grades of the ramps, degrees; negative goes down.
        starts: Trials on each ramp.
        speed: Commanded forward speed, m/s, straight up or down the ramp; negative is backward. 0 commands the robot to
            stand on it, unless it is to walk to a side or to turn.
        lateral: Commanded speed to the left, m/s; negative is to the right.
        yaw_rate: Commanded yaw rate, rad/s, positive to the left; 0 holds the heading.
        across: Turns the ramp by 90 degrees, so that the robot faces across it: positive grades rise to its left,
            negative ones to its right.
        push: Change of the horizontal velocity by each push, m/s, in a random direction; 0 for none.
        push_every: Time from one push to the next, s.
        seconds: Length of a trial, s.
        timestep: Physics step, s; the control step stays the task's.
        friction: Smallest friction coefficient between feet and ground.
        friction_margin: The coefficient is at least tan(grade) plus this.
        fall_height: A root lower above the ground than this is a fall, m; as in Stage I's training.
        fall_tilt: A root that leans further from the vertical than this is a fall, degrees; as in Stage I's training.
        seed: Seed of the random starts.
    """

    VERB: ClassVar[str] = "ramps"

    grades: Grades = (0.0, 10.0, -10.0, 20.0, -20.0, 25.0, -25.0, 30.0, -30.0)
    starts: Count = 256
    speed: Finite = 0.5
    lateral: Finite = 0.0
    yaw_rate: Finite = 0.0
    across: bool = False
    push: NotNegative = 0.0
    push_every: Positive = 5.0
    seconds: Positive = 20.0
    timestep: Timestep = 0.005
    friction: NotNegative = 0.8
    friction_margin: NotNegative = 0.3
    fall_height: NotNegative = 0.4
    fall_tilt: NotNegative = 55.0
    seed: Seed = 1000

    def __post_init__(self) -> None:
        super().__post_init__()
        for speed, extent in ((self.speed, self.tile_length), (self.lateral, self.tile_width)):
            if extent > LONGEST:
                raise UserError(
                    f"{self.VERB}: {speed:g} m/s for {self.seconds:g} s needs {extent:g} m of ground; "
                    f"there are at most {LONGEST:g} m."
                )

    @property
    def standing(self) -> bool:
        """True if the robot is commanded to stand."""
        return self.speed == self.lateral == self.yaw_rate == 0.0

    @property
    def straight(self) -> bool:
        """True if the robot is commanded to walk forward, straight up or down a ramp with an approach."""
        return self.speed > 0.0 and self.lateral == self.yaw_rate == 0.0 and not self.across

    @property
    def in_words(self) -> str:
        """What the robot is commanded, and what happens to it, such as "0.5 m/s across the slope"."""
        words = [f"{self.speed:g} m/s"]
        if self.lateral:
            words.append(f"{abs(self.lateral):g} m/s to the {'left' if self.lateral > 0.0 else 'right'}")
        if self.yaw_rate:
            words.append(f"{self.yaw_rate:g} rad/s")
        pushes = f", pushed by {self.push:g} m/s every {self.push_every:g} s," if self.push else ""
        return f"{', '.join(words)}{' across the slope' if self.across else ''}{pushes}"

    @property
    def approach(self) -> float:
        """Level ground before the ramp, m; none if the robot starts on the slope."""
        return APPROACH if self.straight else 0.0

    @property
    def tile_length(self) -> float:
        """Extent of the ground in the direction of travel, m.

        It is long enough for 2.5 times the commanded speed; where the robot starts in its middle, also for one that
        creeps at `CREEP` up or down.
        """
        if self.straight:
            return max(4.0, float(math.ceil(SPAWN_X + 2.5 * self.speed * self.seconds)))
        return max(4.0, float(math.ceil(2.0 * (self._reach(self.speed) + EDGE + ALONG))))

    @property
    def tile_width(self) -> float:
        """Extent of the ground across, m; wide enough as `tile_length` unless the robot keeps to the centre line."""
        if self.straight or (self.standing and not self.across):
            return WIDTH
        return max(WIDTH, float(math.ceil(2.0 * (self._reach(self.lateral) + EDGE + ACROSS))))

    def _reach(self, speed: float) -> float:
        return max(2.5 * abs(speed), CREEP) * self.seconds

    @property
    def start_along(self) -> tuple[float, float]:
        """Range of the random start, m from `SPAWN_X`."""
        middle = 0.0 if self.straight else 0.5 * self.tile_length - SPAWN_X
        return middle - ALONG, middle + ALONG

    def friction_on(self, grade: float) -> float:
        """Coefficient of friction on a ramp of `grade` degrees."""
        return max(self.friction, math.tan(math.radians(abs(grade))) + self.friction_margin)


@dataclass(frozen=True)
class Standing:
    """Figures of a robot that was commanded to stand, from 2 s on.

    Attributes:
        creep_along, creep_across: |velocity| along the ground, forward and to the left, mean of the trials' means, m/s.
            A robot that sways on the spot has some of it too.
        drift: Distance on the ground between the places at 2 s and at the end, averaged over trials, m.
        touchdowns_per_s: Steps as `humoslope.deploy.gait.STEP` says, averaged over trials, 1/s.
    """

    creep_along: float | None
    creep_across: float | None
    drift: float | None
    touchdowns_per_s: float | None


@dataclass(frozen=True)
class Manoeuvre:
    """Figures of a robot that was commanded to do anything but walk straight ahead or stand, from 2 s on.

    Attributes:
        lateral_speed: Speed to the left along the ground, mean of the trials' means, m/s.
        velocity_error: Distance of a trial's mean velocity along the ground, forward and to the left, from the
            commanded one, averaged over trials, m/s.
        yaw_rate: Rate about the vertical, mean of the trials' means, rad/s.
        yaw_rate_error: Difference of a trial's mean rate from the commanded one, averaged over trials, rad/s.
        slip: Speed down the slope that the robot faces across, along the ground: from the places at 2 s and at the end,
            averaged over trials, m/s. None if it does not face across a slope.
    """

    lateral_speed: float | None
    velocity_error: float | None
    yaw_rate: float | None
    yaw_rate_error: float | None
    slip: float | None


@dataclass(frozen=True)
class RampResult:
    """Figures of one ramp; None where no trial lasted long enough to measure them.

    Attributes:
        grade: Grade, degrees, negative down.
        friction: Friction coefficient between feet and ground.
        falls: Trials that ended in a fall.
        left_course: Trials that ended early because the robot had walked off its tile: neither a fall nor a full trial.
        speed: Forward speed along the ground from 2 s on, mean of the trials' means, m/s.
        speed_error: Difference of a trial's mean speed from the commanded one, averaged over trials, m/s.
        speed_rms_error: Root mean square of the difference at each instant, m/s.
        root_height: Height of the root above the ground below it, m.
        self_contact: Share of the time in which two parts of the robot press on each other, mean of the trials' shares.
        distance: Mean distance walked along the course on its surface, m.
        seconds: Mean duration of a trial, s.
        standing: Further figures if the robot was commanded to stand, else None.
        manoeuvre: Further figures if it was commanded to do anything but stand or walk straight ahead, else None.
    """

    grade: float
    friction: float
    falls: Proportion
    left_course: int
    speed: float | None
    speed_error: float | None
    speed_rms_error: float | None
    root_height: float | None
    self_contact: float | None
    distance: float
    seconds: float
    standing: Standing | None = None
    manoeuvre: Manoeuvre | None = None


def ramp_env_cfg(
    task_env: EnvCfg, protocol: RampProtocol, groups: Sequence[str] = ("actor",), verb: str = "ramps"
) -> EnvCfg:
    """A task's environment reduced to its robot, its actions and the observations of the policy, on the ramps of this
    protocol. The envs are assigned to the grades in their order, `starts` to each.

    The protocol says what a fall is: a task may end an episode when the robot has only walked downhill.

    Args:
        groups: Observation groups that the policy reads.
        verb: Verb of the command line that asks for it, for messages.

    Raises:
        UserError: If the protocol's physics step does not divide the task's control step, or the task does not have one
            of the groups.
    """
    friction = {"friction": (protocol.friction,) * 2, "slope_margin": protocol.friction_margin}
    start = {"along": protocol.start_along, "across": (-ACROSS, ACROSS), "yaw": (-YAW, YAW)}
    happenings = Terms(
        friction=EventTermCfg(events.randomize_friction, friction, mode="startup"),
        root=EventTermCfg(events.ResetOnTile, start),
        joints=EventTermCfg(events.reset_joints, START_JOINTS),
    )
    if protocol.push:
        happenings.push = EventTermCfg(
            events.push_in_random_direction,
            {"speed": protocol.push},
            mode="interval",
            interval_s=(protocol.push_every,) * 2,
        )
    sim = measuring_physics(task_env.sim, protocol.timestep, verb)
    return dataclasses.replace(
        task_env,
        scene=dataclasses.replace(task_env.scene, terrain=_ground(protocol)),
        sim=sim,
        num_envs=protocol.starts * len(protocol.grades),
        # The trial ends first, so that a time-out never ends an episode here.
        episode_length_s=protocol.seconds + 10.0 * sim.timestep * sim.decimation,
        seed=protocol.seed,
        command=task_env.command.on_course(
            dataclasses.replace(
                task_env.command,
                speed=(protocol.speed,) * 2,
                lateral=(protocol.lateral,) * 2,
                yaw_rate=(protocol.yaw_rate,) * 2 if protocol.yaw_rate else task_env.command.yaw_rate,
                heading_share=0.0 if protocol.standing or protocol.yaw_rate else 1.0,
                # Only a robot that walks ahead along its tile comes back to the centre line by turning towards it.
                lateral_gain=task_env.command.lateral_gain if protocol.straight else 0.0,
                standing_share=1.0 if protocol.standing else 0.0,
                modes={},
            )
        ),
        observations=policy_observations(task_env, groups, enable_corruption=False),
        rewards=Terms(),
        terminations=Terms(
            time_out=TerminationTermCfg(terminations.time_out, time_out=True),
            off_tile=TerminationTermCfg(terminations.off_tile, {"margin": EDGE}, time_out=True),
            root_too_low=TerminationTermCfg(terminations.root_too_low, {"height": protocol.fall_height}),
            tilted=TerminationTermCfg(terminations.tilted, {"degrees": protocol.fall_tilt}),
        ),
        events=happenings,
        curriculum=Terms(),
    )


def _ground(protocol: RampProtocol) -> TileRowCfg:
    up, down = (
        Kind(name, (0.0, STEEPEST), partial(_ramp, sign=sign, approach=protocol.approach, across=protocol.across))
        for name, sign in (("up", 1.0), ("down", -1.0))
    )
    tiles = [Tile(down if grade < 0.0 else up, abs(grade)) for grade in protocol.grades]
    return TileRowCfg(tiles, tile_length=protocol.tile_length, tile_width=protocol.tile_width)


def _ramp(
    x: Array, y: Array, grade: float, rng: np.random.Generator, sign: float, approach: float, across: bool
) -> Array:
    """Level up to `approach`, then a plane to the end of the tile; or one plane that rises to the left."""
    return sign * math.tan(math.radians(grade)) * (y if across else np.maximum(x - approach, 0.0))


def along_course(x: Array, grade: float, approach: float = APPROACH) -> Array:
    """Distance on the ground from the start of the tile to each place `x` along it, m."""
    return np.minimum(x, approach) + np.maximum(x - approach, 0.0) / math.cos(math.radians(grade))


def run_trials(
    env: ManagerBasedRlEnv,
    policy: Callable[[TensorDict], Tensor],
    protocol: RampProtocol,
    on_step: Callable[[], None] = lambda: None,
) -> Trials:
    """Runs one trial in every env of an environment made by `ramp_env_cfg`.

    Args:
        on_step: Called after every control step.
    """
    signals, start = env.signals, env.tiles.origin_w[:, :2]
    settle = round(SETTLE_S / env.step_dt)
    recorder = Recorder(signals.root_pos_w[:, :2] - start, protocol.speed, settle, env.step_dt)

    def observe(failed: Tensor, ended: Tensor) -> None:
        recorder.add(
            place=signals.root_pos_w[:, :2] - start,
            velocity=signals.root_lin_vel_t[:, :2],
            yaw_rate=-(signals.projected_gravity_b * signals.root_ang_vel_b).sum(dim=1),
            height=signals.root_height,
            contact=signals.foot_force >= FOOT_DOWN_N,
            self_contact=signals.self_force > CONTACT_FORCE,
            failed=failed,
            ended=ended,
        )

    rollout(env, policy, protocol.seconds, observe, on_step)
    return recorder.trials()


def summarise(trials: Trials, protocol: RampProtocol) -> list[RampResult]:
    """Figures of every ramp, in the order of the protocol's grades."""
    results = []
    for i, grade in enumerate(protocol.grades):
        there = trials[i * protocol.starts : (i + 1) * protocol.starts]
        incline = 0.0 if protocol.across else grade
        first, last = (along_course(place, incline, protocol.approach) for place in (there.start, there.end))
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
                self_contact=mean(there.self_contact),
                distance=float((last - first).mean()),
                seconds=float(there.seconds.mean()),
                standing=_standing(there, grade, protocol.across) if protocol.standing else None,
                manoeuvre=None if protocol.standing or protocol.straight else _manoeuvre(there, grade, protocol),
            )
        )
    return results


def _standing(trials: Trials, grade: float, faces_across: bool) -> Standing:
    along, across = trials.drift.T
    inclined, level = (across, along) if faces_across else (along, across)
    return Standing(
        creep_along=mean(trials.creep[:, 0]),
        creep_across=mean(trials.creep[:, 1]),
        drift=mean(np.hypot(inclined / math.cos(math.radians(grade)), level)),
        touchdowns_per_s=mean(trials.touchdowns),
    )


def _manoeuvre(trials: Trials, grade: float, protocol: RampProtocol) -> Manoeuvre:
    off = np.hypot(trials.speed - protocol.speed, trials.lateral - protocol.lateral)
    return Manoeuvre(
        lateral_speed=mean(trials.lateral),
        velocity_error=mean(off),
        yaw_rate=mean(trials.yaw_rate),
        yaw_rate_error=mean(np.abs(trials.yaw_rate - protocol.yaw_rate)),
        slip=mean(_slip(trials, grade)) if protocol.across and grade else None,
    )


def _slip(trials: Trials, grade: float) -> Array:
    """Speed down a slope that rises to the left for positive grades, along the ground, [N] m/s."""
    downhill = -math.copysign(1.0, grade) * trials.drift[:, 1] / math.cos(math.radians(grade))
    return downhill / trials.measured_s


FALLS = ("grade\n°", "\nfalls", "share\n%", "95 %\ninterval", "off\ncourse")
WALKING = {"speed\nm/s": 3, "error\nm/s": 3, "RMS\nm/s": 3, "height\nm": 3, "way\nm": 2, "self\n%": 1}
STANDING = {"creep\nm/s": 3, "across\nm/s": 3, "drift\nm": 2, "steps\n1/s": 2, "height\nm": 3, "self\n%": 1}
MANOEUVRE = {"ahead\nm/s": 3, "left\nm/s": 3, "off\nm/s": 3, "turn\nrad/s": 3, "off\nrad/s": 3, "self\n%": 1}
ACROSS_SLOPE = {"ahead\nm/s": 3, "left\nm/s": 3, "off\nm/s": 3, "slip\nm/s": 3, "height\nm": 3, "self\n%": 1}
"""Columns of the table and their decimals."""


def table(results: Sequence[RampResult]) -> Table:
    """Figures as a table, from the steepest descent to the steepest ascent."""
    # Without padding a row fits into a terminal of 80 columns; a cut number is worse than a tight one.
    table = Table(title="Ramps", box=SIMPLE_HEAD, padding=0, pad_edge=False)
    caption = "averages: from 2 s on, while the robot is up; self: share of that time in contact with itself"
    columns = _columns(results)
    table.caption = f"{caption}; {STEP}" if columns is STANDING else caption
    for column in (*FALLS, *columns):
        table.add_column(column, justify="right", no_wrap=True)
    for r in sorted(results, key=lambda r: r.grade):
        touching = None if r.self_contact is None else 100.0 * r.self_contact
        if (s := r.standing) is not None:
            figures = (s.creep_along, s.creep_across, s.drift, s.touchdowns_per_s, r.root_height, touching)
        elif (m := r.manoeuvre) is None:
            figures = (r.speed, r.speed_error, r.speed_rms_error, r.root_height, r.distance, touching)
        elif columns is ACROSS_SLOPE:
            figures = (r.speed, m.lateral_speed, m.velocity_error, m.slip, r.root_height, touching)
        else:
            figures = (r.speed, m.lateral_speed, m.velocity_error, m.yaw_rate, m.yaw_rate_error, touching)
        table.add_row(
            f"{r.grade:+g}" if r.grade else "0",
            f"{r.falls.count}/{r.falls.total}",
            f"{100.0 * r.falls.share:.1f}",
            f"{100.0 * r.falls.low:.1f}-{100.0 * r.falls.high:.1f}",
            str(r.left_course),
            *("-" if v is None else f"{v:.{digits}f}" for v, digits in zip(figures, columns.values(), strict=True)),
        )
    return table


def _columns(results: Sequence[RampResult]) -> dict[str, int]:
    """Columns of the table that tell what the robot was commanded."""
    if any(r.standing for r in results):
        return STANDING
    manoeuvres = [r.manoeuvre for r in results if r.manoeuvre is not None]
    if not manoeuvres:
        return WALKING
    return ACROSS_SLOPE if any(m.slip is not None for m in manoeuvres) else MANOEUVRE
