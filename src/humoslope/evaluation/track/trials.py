"""The held-out benchmark: worlds that walk one trial of their cell after the other, until all trials are done.

A world belongs to a cell (a grade and a friction tier) and walks that cell's trials lane, lane + L, lane + 2 L, ...,
where L is the number of lanes. Which world walks a trial, and every random number of it, depend on the trial alone. So
the same command gives the same figures, and an evaluation that was interrupted gives those that it would have given.
(Not so with another number of lanes: a matrix product of another size may round differently.) A world without trials
left is not simulated further.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor

from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.evaluation.common import measuring_physics
from humoslope.evaluation.track import random
from humoslope.evaluation.track.arrays import map_arrays, where_arrays
from humoslope.evaluation.track.protocol import HeldOutProtocol
from humoslope.evaluation.track.recorder import StepSample, TrackRecorder, TrackTrials
from humoslope.evaluation.track.referee import OUTCOMES, Referee, Situation
from humoslope.managers import EventTermCfg, RewardTermCfg, TerminationTermCfg, Terms, VelocityCommandCfg
from humoslope.mdp import events, rewards
from humoslope.slope import quaternion
from humoslope.statistics import Array, Bools
from humoslope.terrain.course import Course

LIFT = 0.01
"""Height of the soles over the ground at the start, m; as in training."""


@dataclass(frozen=True)
class HeldOutTrials:
    """T trials on the host, cell by cell: those of the first grade's first tier, then those of its second tier, ...

    Attributes:
        metrics: What was measured on the way.
        success, fell, left, timed_out: [T] bool, how they ended; none holds for a trial that has not.
        seconds: [T] until the end, s.
        max_place: [T] furthest place of the root, m from the start of the course.
        grade_index, tier_index: [T] int64, of the protocol's grades and tiers.
    """

    metrics: TrackTrials
    success: Bools
    fell: Bools
    left: Bools
    timed_out: Bools
    seconds: Array
    max_place: Array
    grade_index: NDArray[np.int64]
    tier_index: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.success)

    def __getitem__(self, which: slice | np.ndarray) -> HeldOutTrials:
        return map_arrays(lambda values: values[which], self)

    @property
    def finished(self) -> Bools:
        """[T] bool."""
        return self.success | self.fell | self.left | self.timed_out


class Relay:
    """Hands the worlds their trials and keeps the results; its methods are terms of the environment.

    Args:
        lanes: Trials of a cell that are walked side by side.
        earlier: Trials of the same protocol, of which those that are finished need not be walked again.

    Attributes:
        trial: [W] index of the trial that each world walks; the number of trials if it has none.
        running: [W] bool; worlds that walk.
    """

    trial: Tensor
    running: Tensor

    def __init__(
        self, protocol: HeldOutProtocol, course: Course, lanes: int, earlier: HeldOutTrials | None = None
    ) -> None:
        self.protocol, self.course, self.lanes, self.earlier = protocol, course, lanes, earlier
        self._idle = protocol.num_trials

    def set_up(self, env: ManagerBasedRlEnv, mask: Tensor) -> None:
        """Startup event: sets the friction of every world, and prepares its trials."""
        protocol, device, total = self.protocol, env.device, self.protocol.num_trials
        cells = [(grade, tier) for grade in protocol.grades for tier in protocol.tiers]
        mu = torch.tensor([math.tan(math.radians(grade)) + tier for grade, tier in cells], device=device)
        events.set_friction(env, mask, mu.repeat_interleave(self.lanes))
        keys = [random.trial_keys(protocol.seed, *cell, protocol.trials) for cell in cells]
        # Every table has a last row for the worlds that have no trial: they may write there, and nobody looks.
        self._keys = torch.cat([*keys, torch.zeros(1, 2, dtype=torch.int64)]).to(device)  # [T + 1, 2]
        self._pending = torch.from_numpy(self._still_to_walk()).to(device)  # [W, rounds + 1]
        self._round = env.zeros(dtype=torch.int64) - 1
        self._outcome = torch.zeros(total + 1, len(OUTCOMES), dtype=torch.bool, device=device)
        self._seconds, self._places = (torch.zeros(total + 1, device=device) for _ in range(2))
        self._furthest = env.zeros()  # [W] m
        self._referee = Referee(protocol, 0.5 * self.course.width, env.step_dt)
        self._recorder = TrackRecorder(
            total,
            len(self.course.segments),
            env.step_dt,
            robot=env.robot,
            length=self.course.length,
            device=device,
        )

    def start(self, env: ManagerBasedRlEnv, mask: Tensor) -> None:
        """Reset event: the worlds in `mask` take their next trial, and its start."""
        protocol, start, joints = self.protocol, env.start_qpos, env.robot.num_joints
        last = self._pending.shape[1] - 1
        self._round = (self._round + mask).clamp(max=last)
        self.trial = self._pending.gather(1, self._round[:, None])[:, 0]
        self.running = self.trial < self._idle
        start_key, self._noise_key = self._keys[self.trial].unbind(dim=1)
        draws = 2.0 * random.uniform(start_key, torch.zeros_like(start_key), 2 + joints) - 1.0  # [W, 2 + J]
        start[:, 0] = env.tiles.origin_w[:, 0] + protocol.start_place + protocol.start_along * draws[:, 0]
        start[:, 1] = env.tiles.origin_w[:, 1]
        start[:, 2] += env.terrain.height(start[:, :2]) + LIFT
        start[:, 3:7] = quaternion.from_yaw(math.radians(protocol.start_yaw) * draws[:, 1])
        moved = start[:, 7:] + protocol.start_joints * draws[:, 2:]
        start[:, 7:] = torch.clamp(moved, env.joint_range[:, 0], env.joint_range[:, 1])
        self._referee.reset(mask)
        self._furthest = torch.where(mask, start[:, 0] - env.tiles.origin_w[:, 0], self._furthest)

    def noise(self, env: ManagerBasedRlEnv, frame: Tensor) -> Tensor:
        """Noise source of the actor's observations: every trial has its own."""
        return random.uniform(self._noise_key, env.episode_length_buf, frame.shape[1])

    def ended(self, env: ManagerBasedRlEnv) -> Tensor:
        """Termination: records the instant, and says which trials end with it, bool [W]."""
        signals = env.signals
        place = signals.root_pos_w[:, 0] - env.tiles.origin_w[:, 0]
        sample = StepSample.read(env, self._recorder.legs, place, self.course.segment_at(place))
        seconds = env.episode_length_buf * env.step_dt
        verdict = self._referee.judge(
            Situation(
                place=place,
                across=signals.root_pos_w[:, 1] - env.tiles.origin_w[:, 1],
                com_height=sample.com_height,
                upright=-signals.projected_gravity_b[:, 2],
                upper_force=signals.upper_force,
                diverged=env.diverged,
                seconds=seconds,
            )
        )
        there = self.running & ~env.diverged
        self._recorder.add(self.trial, sample, there)
        self._furthest = torch.where(there, torch.maximum(self._furthest, place), self._furthest)
        ended = verdict.any(dim=1) & self.running
        row = torch.where(ended, self.trial, self._idle)
        self._outcome[row] = verdict
        self._seconds[row] = seconds
        self._places[row] = self._furthest
        return ended

    def trials(self) -> HeldOutTrials:
        """What there is so far. Waits for the device."""
        total, protocol = self._idle, self.protocol
        outcome = dict(zip(OUTCOMES, self._outcome[:total].cpu().numpy().T, strict=True))
        cell = np.arange(total) // protocol.trials
        walked = HeldOutTrials(
            metrics=self._recorder.trials(),
            **outcome,
            seconds=self._seconds[:total].cpu().numpy().astype(np.float64),
            max_place=self._places[:total].cpu().numpy().astype(np.float64),
            grade_index=cell // len(protocol.tiers),
            tier_index=cell % len(protocol.tiers),
        )
        if self.earlier is None:
            return walked
        before = self.earlier.finished
        return map_arrays(partial(where_arrays, before), self.earlier, walked)

    def progress(self) -> float:
        """Share of all trials that is done, in [0, 1]; a trial on its way counts by its place. Waits for the device."""
        finished = self.trials().finished.sum()
        share = (self._furthest / self.protocol.success_place).clamp(0.0, 1.0)
        return float((finished + (share * self.running).sum()) / self._idle)

    def _still_to_walk(self) -> NDArray[np.int64]:
        """The trials of each world in their order, [W, rounds + 1], filled up with the idle one."""
        protocol = self.protocol
        done = np.zeros(self._idle, dtype=bool) if self.earlier is None else self.earlier.finished
        rounds = -(-protocol.trials // self.lanes)
        table = np.full((protocol.num_cells * self.lanes, rounds + 1), self._idle, dtype=np.int64)
        for world, row in enumerate(table):
            cell, lane = divmod(world, self.lanes)
            own = cell * protocol.trials + np.arange(lane, protocol.trials, self.lanes)
            left = own[~done[own]]
            row[: len(left)] = left
        return table


def held_out_env_cfg(task_env: EnvCfg, relay: Relay) -> EnvCfg:
    """The environment of a task, stripped to its robot, its actions and what its actor observes, on the course.

    Nothing else of the task is left: not its terminations, commands, events or curriculum.

    Raises:
        UserError: If the protocol's physics step does not divide the task's control step.
    """
    protocol = relay.protocol
    actor = dataclasses.replace(task_env.observations.actor, enable_corruption=protocol.noise, noise_source=relay.noise)
    return EnvCfg(
        scene=dataclasses.replace(task_env.scene, terrain=relay.course.ground(protocol.grades)),
        sim=measuring_physics(task_env.sim, protocol.timestep, "evaluate"),
        num_envs=protocol.num_cells * relay.lanes,
        episode_length_s=protocol.timeout_s,
        seed=protocol.seed,
        actions=task_env.actions,
        command=VelocityCommandCfg(
            speed=(protocol.speed,) * 2,
            lateral=(0.0, 0.0),
            heading_share=1.0,
            heading_gain=protocol.heading_gain,
            lateral_gain=protocol.lateral_gain,
            yaw_rate_limit=protocol.yaw_rate_limit,
            standing_share=0.0,
        ),
        observations=Terms(actor=actor),
        rewards=Terms(alive=RewardTermCfg(rewards.alive)),  # not used; an environment must have one
        terminations=Terms(trial=TerminationTermCfg(relay.ended)),
        events=Terms(set_up=EventTermCfg(relay.set_up, mode="startup"), start=EventTermCfg(relay.start)),
    )


def walk(
    env: ManagerBasedRlEnv,
    policy: Callable[[TensorDict], Tensor],
    relay: Relay,
    on_step: Callable[[Tensor], None] = lambda running: None,
) -> HeldOutTrials:
    """Lets the policy walk every trial of `relay` that is left, in an environment made by `held_out_env_cfg`.

    Args:
        on_step: Called after every control step with the worlds [W] that took it.
    """
    with torch.inference_mode():
        while bool(relay.running.any()):
            running = relay.running
            env.step(policy(env.get_observations()), running)
            on_step(running)
    return relay.trials()
