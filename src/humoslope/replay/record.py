"""Recording of a policy's walk over a terrain as a rollout."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, ClassVar

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.evaluation.ramps import RampProtocol, ramp_env_cfg
from humoslope.learning.policy import Provenance
from humoslope.managers import EventTermCfg, RewardTermCfg, Terms, control_steps
from humoslope.mdp.bsga import ComHeight
from humoslope.mdp.events import push, set_friction
from humoslope.mdp.zmp import ZmpRegulariser
from humoslope.provenance import git_state, plain
from humoslope.ranges import Checked, Finite, NotNegative, Positive, Seed, Share, Timestep
from humoslope.replay import events
from humoslope.replay.recorder import RolloutRecorder
from humoslope.replay.rollout import Columns, Event, Rollout
from humoslope.terrain import course, registry
from humoslope.terrain.grid import SPAWN_X, Tile, TileRowCfg

USUAL_GRADE = 20.0
"""Default grade, degrees."""
ROOM = 1.5
"""Length of the ground, in commanded distances."""
SHORTEST = 10.0
"""Shortest tile, m; as in training."""


@dataclass(frozen=True)
class RecordProtocol(Checked):
    """Terrain, command and physics of a recording: one env, without noise, harness and randomisation but of the start.

    Attributes:
        terrain: Name of a registered terrain, or of a course such as the held-out track.
        grade: Grade of the terrain, degrees; by default 20, or the nearest that it has.
        level: Difficulty in [0, 1] instead of a grade.
        seconds: Length of the recording, s; it ends earlier where the ground ends. The held-out track takes some 70 s.
        speed: Commanded forward speed, m/s.
        push: Largest change of the root's velocity by a push, m/s along each axis; 0 for none.
        push_every: Time between pushes, s.
        timestep: Physics step, s; the control step stays the task's.
        friction: Smallest coefficient of friction between feet and ground.
        friction_margin: Smallest difference between the coefficient of friction and tan(grade), as on the track.
        seed: Seed of the random start and the pushes.
    """

    VERB: ClassVar[str] = "record"

    terrain: str = "ramp-up"
    grade: Finite | None = None
    level: Share | None = None
    seconds: Positive = 60.0
    speed: Positive = 0.5
    push: NotNegative = 0.0
    push_every: Positive = 5.0
    timestep: Timestep = 0.005
    friction: NotNegative = 0.8
    friction_margin: NotNegative = 0.3
    seed: Seed = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.grade is not None and self.level is not None:
            raise UserError("record: give a grade or a level, not both.")

    def resolve_grade(self) -> float:
        """Returns the grade, degrees.

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

    @property
    def coefficient(self) -> float:
        """Coefficient of friction between feet and ground."""
        return max(self.friction, math.tan(math.radians(abs(self.resolve_grade()))) + self.friction_margin)

    def ground(self) -> TileRowCfg:
        """Returns the terrain at its grade: a course unchanged, any other terrain long enough for the walk."""
        if course.is_course(self.terrain):
            return course.find(self.terrain).ground((self.resolve_grade(),))
        length = max(SHORTEST, math.ceil(SPAWN_X + ROOM * self.speed * self.seconds))
        return TileRowCfg([Tile(registry.find(self.terrain), self.resolve_grade())], tile_length=float(length))


def record_env_cfg(task_env: EnvCfg, protocol: RecordProtocol, groups: Sequence[str] = ("actor",)) -> EnvCfg:
    """Returns one env of a task, with its rewards, set up as in the ramp check, on the protocol's terrain.

    Args:
        task_env: Environment of the task.
        protocol: What to record.
        groups: Observation groups that the policy reads; they are kept, without noise.

    Raises:
        UserError: If the task has no such group, or cannot be recorded with the protocol's physics.
    """
    same = ("speed", "timestep", "seed")
    # A second on the flat, since ground and time are others here.
    ramp = RampProtocol(grades=(0.0,), starts=1, seconds=1.0, **{name: getattr(protocol, name) for name in same})
    cfg = ramp_env_cfg(task_env, ramp, groups, protocol.VERB)
    cfg.scene = dataclasses.replace(task_env.scene, terrain=protocol.ground())
    cfg.episode_length_s += protocol.seconds - ramp.seconds
    cfg.rewards = task_env.rewards
    cfg.events.friction = EventTermCfg(hold_friction, {"mu": protocol.coefficient}, mode="startup")
    if protocol.push:
        every = (protocol.push_every,) * 2
        cfg.events.push = EventTermCfg(push, {"speed": protocol.push}, mode="interval", interval_s=every)
    return cfg


def hold_friction(env: ManagerBasedRlEnv, mask: Tensor, mu: NotNegative) -> None:
    """Event: sets the coefficient of friction between feet and ground.

    Args:
        mu: The coefficient.
    """
    set_friction(env, mask, torch.full((env.num_envs,), mu, device=env.device))


def _params(rewards: Terms[RewardTermCfg], kind: type) -> dict[str, Any] | None:
    """Parameters of the reward term with that function; None if there is none."""
    return next((term.params for _, term in rewards.items() if term.func is kind), None)


def record(
    env: ManagerBasedRlEnv,
    policy: Callable[[TensorDict], Tensor],
    protocol: RecordProtocol,
    on_step: Callable[[], None] = lambda: None,
) -> Rollout:
    """Records a walk of the policy in an environment made by `record_env_cfg`. A robot that falls is reset.

    Args:
        env: The environment.
        policy: Actions for observations.
        protocol: The protocol that the environment was made for.
        on_step: Called after every control step.

    Returns:
        The rollout, without the origin of the policy in its header; see `with_provenance`.
    """
    rewards = env.cfg.rewards
    recorder = RolloutRecorder(env, _params(rewards, ZmpRegulariser) or {}, _params(rewards, ComHeight))
    with torch.inference_mode():
        for _ in range(control_steps("record: seconds", protocol.seconds, env.step_dt)):
            env.step(policy(env.get_observations()))
            recorder.after_step()
            on_step()
            if recorder.ended:
                break
    columns = recorder.columns()
    terrain = env.cfg.scene.terrain.build()
    header = {
        "dt": env.step_dt,
        "physics": plain(env.cfg.sim) | {"backend": env.sim.backend, "device": str(env.device)},
        "protocol": plain(protocol),
        "friction": protocol.coefficient,
        "robot": _robot_header(env),
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
    return Rollout(header, columns, terrain.heights, _events(env, protocol, recorder, columns))


def _robot_header(env: ManagerBasedRlEnv) -> dict[str, Any]:
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


def _events(
    env: ManagerBasedRlEnv, protocol: RecordProtocol, recorder: RolloutRecorder, columns: Columns
) -> tuple[Event, ...]:
    """All events in the order of time. Ground events come from a course's segments, elsewhere from the fitted plane."""
    happened = events.falls(columns, recorder.fell)
    happened += events.causes(columns, happened, np.stack(recorder.moments), env.step_dt)
    if course.is_course(protocol.terrain):
        track = course.find(protocol.terrain)
        names = [segment.name for segment in track.segments]
        happened += events.segments(columns, float(env.tiles.origin_w[0, 0]), names, track.ends)
    else:
        happened += events.grounds(columns, env.step_dt)
    happened += events.pushes(recorder.pushes)
    happened += events.touches(columns, env.step_dt)
    if recorder.ended:
        happened.append(Event(float(columns.time[-1]), "end", "end of the ground"))
    return tuple(sorted(happened))


def with_provenance(rollout: Rollout, provenance: Provenance, label: str) -> Rollout:
    """Returns the rollout with the origin of the policy in its header, called `label` in viewers."""
    checkpoint = plain(provenance) | {"training": provenance.training}
    header = rollout.header | {
        "task": provenance.task,
        "label": label,
        "checkpoint": checkpoint,
        "code": git_state().splitlines()[0],
        "recorded": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    return dataclasses.replace(rollout, header=header)
