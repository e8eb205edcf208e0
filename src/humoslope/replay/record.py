"""A policy walks once over a terrain, and the walk is kept as a rollout."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.errors import UserError, require_not_negative, require_positive
from humoslope.evaluation.ramps import RampProtocol, ramp_env_cfg
from humoslope.learning.policy import Provenance
from humoslope.managers import EventTermCfg, RewardTermCfg, Terms
from humoslope.mdp.bsga import ComHeight
from humoslope.mdp.zmp import ZmpRegulariser
from humoslope.provenance import git_state, plain
from humoslope.replay import events
from humoslope.replay.recorder import Pushes, Recorder
from humoslope.replay.rollout import Columns, Event, Rollout
from humoslope.terrain import course, registry
from humoslope.terrain.grid import SPAWN_X, Tile, TileRowCfg

USUAL_GRADE = 20.0
"""Grade where none is asked for, degrees."""
ROOM = 1.5
"""Ground for this many times the commanded way."""
SHORTEST = 10.0
"""Shortest tile, m; as in training."""


@dataclass(frozen=True)
class RecordProtocol:
    """What is recorded: one world, no noise, no harness and no randomisation but the start.

    Attributes:
        terrain: A registered terrain, or a course such as the held-out track.
        grade: Of that terrain, degrees; by default 20, or the nearest that it has.
        level: Difficulty in [0, 1] instead of a grade.
        seconds: Length of the recording, s; it ends earlier where the ground does. The held-out track takes some 70 s.
        speed: Commanded forward speed, m/s.
        push: Largest change of the root's velocity by a push, m/s along each axis; 0 for none.
        push_every: Time between pushes, s.
        timestep: Physics step, s; the control step stays the task's.
        friction: Smallest coefficient between feet and ground.
        friction_margin: The coefficient is at least tan(grade) plus this.
        seed: Of the start and the pushes.
    """

    terrain: str = "ramp-up"
    grade: float | None = None
    level: float | None = None
    seconds: float = 60.0
    speed: float = 0.5
    push: float = 0.0
    push_every: float = 5.0
    timestep: float = 0.005
    friction: float = 0.8
    friction_margin: float = 0.3
    seed: int = 0

    def __post_init__(self) -> None:
        if self.grade is not None and self.level is not None:
            raise UserError("record: give a grade or a level, not both.")
        if self.level is not None and not 0.0 <= self.level <= 1.0:
            raise UserError(f"record: level {self.level:g} must be between 0 and 1.")
        require_positive(
            "record", seconds=self.seconds, speed=self.speed, push_every=self.push_every, timestep=self.timestep
        )
        require_not_negative("record", push=self.push, friction=self.friction, friction_margin=self.friction_margin)

    def resolve_grade(self) -> float:
        """The grade in degrees.

        Raises:
            UserError: If the terrain does not exist or does not have the grade.
        """
        kind = registry.find(self.terrain)
        low, high = kind.grade
        if self.level is not None:
            return kind.grade_at(self.level)
        if self.grade is None:
            return min(max(USUAL_GRADE, low), high)
        if not low <= self.grade <= high:
            raise UserError(
                f"terrain '{self.terrain}': grade {self.grade:g} must be between {low:g} and {high:g} degrees."
            )
        return self.grade

    def ground(self) -> TileRowCfg:
        """The terrain at its grade: a course as it is, any other terrain long enough for the walk."""
        if course.is_course(self.terrain):
            return course.find(self.terrain).ground((self.resolve_grade(),))
        length = max(SHORTEST, math.ceil(SPAWN_X + ROOM * self.speed * self.seconds))
        return TileRowCfg([Tile(registry.find(self.terrain), self.resolve_grade())], tile_length=float(length))


def record_env_cfg(task_env: EnvCfg, protocol: RecordProtocol) -> EnvCfg:
    """One world of a task, with its rewards, as the ramp check sets it up, on the protocol's terrain.

    Raises:
        UserError: If the task cannot be recorded so.
    """
    same = ("seconds", "speed", "timestep", "friction", "friction_margin", "seed")
    check = RampProtocol(grades=(0.0,), starts=1, **{name: getattr(protocol, name) for name in same})
    cfg = ramp_env_cfg(task_env, check)
    cfg.scene = dataclasses.replace(task_env.scene, terrain=protocol.ground())
    cfg.rewards = task_env.rewards
    if protocol.push:
        every = (protocol.push_every,) * 2
        cfg.events.push = EventTermCfg(Pushes, {"speed": protocol.push}, mode="interval", interval_s=every)
    recorded = {
        "regulariser": _params(task_env.rewards, ZmpRegulariser) or {},
        "com_height": _params(task_env.rewards, ComHeight),
    }
    cfg.events.recorder = EventTermCfg(Recorder, recorded, mode="step")
    return cfg


def _params(rewards: Terms[RewardTermCfg], kind: type) -> dict[str, Any] | None:
    """Parameters of the task's reward of that kind; None if it has none."""
    return next((term.params for _, term in rewards.items() if term.func is kind), None)


def record(
    env: ManagerBasedRlEnv,
    policy: Callable[[TensorDict], Tensor],
    protocol: RecordProtocol,
    on_step: Callable[[], None] = lambda: None,
) -> Rollout:
    """Lets the policy walk in an environment made by `record_env_cfg`. A robot that falls starts anew.

    Args:
        on_step: Called after every control step.

    Returns:
        The rollout; its header does not yet say whose it is, see `signed`.
    """
    recorder: Recorder = env.events["recorder"]
    with torch.inference_mode():
        for _ in range(round(protocol.seconds / env.step_dt)):
            env.step(policy(env.get_observations()))
            on_step()
            if recorder.ended:
                break
    columns = recorder.columns(env.step_dt)
    terrain = env.cfg.scene.terrain.build()
    header = {
        "dt": env.step_dt,
        "physics": plain(env.cfg.sim) | {"backend": env.sim.backend, "device": str(env.device)},
        "protocol": plain(protocol),
        "robot": _describe_robot(env),
        "reward_terms": env.rewards.names,
        "terrain": {
            "name": protocol.terrain,
            "grade": float(terrain.grade[0, 0]),
            "cell": terrain.cell,
            "origin": list(terrain.origin),
            "tile_origin": terrain.tile_origin[0, 0].tolist(),
            "tile_length": terrain.tile_length,
            "tile_width": terrain.tile_width,
        },
    }
    return Rollout(header, columns, terrain.heights, _events(env, protocol, columns))


def _describe_robot(env: ManagerBasedRlEnv) -> dict[str, Any]:
    robot = env.robot
    return {
        "name": robot.name,
        "urdf": robot.urdf.read_text(encoding="utf-8"),
        "root": robot.root_body,
        "joint_names": list(robot.joint_names),
        "default_joint_pos": list(robot.default_joint_pos),
        "action_scale": [scale * env.cfg.actions.scale_factor for scale in robot.action_scale],
        "effort_limit": list(robot.effort_limit),
    }


def _events(env: ManagerBasedRlEnv, protocol: RecordProtocol, columns: Columns) -> tuple[Event, ...]:
    """What happened, in the order of time. On a course its segments tell of the ground, elsewhere the fitted plane."""
    recorder: Recorder = env.events["recorder"]
    happened = events.falls(columns, recorder.fell)
    if course.is_course(protocol.terrain):
        track = course.find(protocol.terrain)
        names = [segment.name for segment in track.segments]
        happened += events.segments(columns, float(env.tiles.origin_w[0, 0]), names, track.ends)
    else:
        happened += events.grounds(columns, env.step_dt)
    if protocol.push:
        pushes: Pushes = env.events["push"]
        happened += events.pushes([(steps * env.step_dt, x, y) for steps, x, y in pushes.kicks])
    if recorder.ended:
        happened.append(Event(float(columns.time[-1]), "end", "end of the ground"))
    return tuple(sorted(happened))


def signed(rollout: Rollout, provenance: Provenance, label: str) -> Rollout:
    """The rollout with its header saying whose it is."""
    checkpoint = plain(provenance) | {"training": provenance.training}
    header = rollout.header | {
        "task": provenance.task,
        "label": label,
        "checkpoint": checkpoint,
        "code": git_state().splitlines()[0],
        "recorded": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    return dataclasses.replace(rollout, header=header)
