"""The held-out benchmark: envs that run one trial of their cell after the other, until all trials are finished.

An env belongs to a cell (a grade and a friction tier) and runs trials i, i + P, i + 2 P, ... of that cell, where P is
the number of parallel trials. The env of a trial, and every random number in it, depend on the trial alone. So the same
command gives the same figures, and an evaluation that was interrupted gives the figures that it would have given. (Not
so with another number of parallel trials, as a matrix product of another size may round differently, nor on a GPU,
where contacts are added up in any order.) An env without trials left is not simulated further.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor

from humoslope.cpu import on_one_thread
from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.evaluation.causes import first_causes
from humoslope.evaluation.common import measuring_physics, policy_observations, to_host
from humoslope.evaluation.moments import LastMoments, MomentReader, MomentTable, complete
from humoslope.evaluation.track import random
from humoslope.evaluation.track.arrays import map_arrays, where_arrays
from humoslope.evaluation.track.protocol import HeldOutProtocol
from humoslope.evaluation.track.recorder import StepSample, TrackRecorder, TrackTrials
from humoslope.evaluation.track.referee import OUTCOMES, Referee, Situation
from humoslope.managers import EventTermCfg, TerminationTermCfg, Terms, VelocityCommandCfg
from humoslope.mdp import events
from humoslope.slope import quaternion
from humoslope.statistics import Array, Bools
from humoslope.terrain.course import Course

LIFT = 0.01
"""Height of the soles over the ground at the start, m; as in training."""


@dataclass(frozen=True)
class HeldOutTrials:
    """T trials on the host, cell by cell: those of the first grade's first tier, then those of its second tier, ...

    Attributes:
        metrics: Recorded values.
        success, fell, left, timed_out: [T] bool, how they ended; none holds for an unfinished trial.
        seconds: [T] duration, s.
        max_place: [T] furthest place of the root, m from the start of the course.
        grade_index, tier_index: [T] int64 indices into the protocol's grades and tiers.
        moments: Last moments of the trials that fell, NaN for all others; empty if they were not kept.
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
    moments: LastMoments = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.success)

    def __getitem__(self, which: slice | np.ndarray) -> HeldOutTrials:
        return map_arrays(lambda values: values[which], self)

    @property
    def finished(self) -> Bools:
        """[T] bool; trials that have ended."""
        return self.success | self.fell | self.left | self.timed_out

    def with_moments(self, steps: int) -> HeldOutTrials:
        """The trials with last moments of so many steps; NaN for those of an older file, which lacks them."""
        return dataclasses.replace(self, moments=complete(self.moments, len(self), steps))

    def causes(self, dt: float) -> list[str]:
        """The first cause of each failed trial, "" for the others; see `causes`.

        Args:
            dt: Control step, s.
        """
        return first_causes(self.moments, dt, fell=self.fell, left=self.left, timed_out=self.timed_out)


class TrialScheduler:
    """Hands trials to the envs and keeps the results.

    Its methods are parts of the environment: `set_up` and `start` are events, `judge` is a termination, `record` an
    observer, and `noise_source` makes the noise of observations.

    Args:
        parallel_trials: Trials of a cell that run side by side.
        earlier: Trials of the same protocol; finished ones are not run again.

    Attributes:
        trial: [N] index of the trial that each env runs; the number of trials if it has none.
        running: [N] bool; envs that run a trial.
    """

    trial: Tensor
    running: Tensor

    def __init__(
        self, protocol: HeldOutProtocol, course: Course, parallel_trials: int, earlier: HeldOutTrials | None = None
    ) -> None:
        self.protocol, self.course, self.parallel_trials, self.earlier = protocol, course, parallel_trials, earlier
        self._idle = protocol.num_trials
        self._noisy_groups = 1

    def noise_source(self, group: int) -> Callable[[ManagerBasedRlEnv, Tensor], Tensor]:
        """Noise source of an observation group: uniform numbers of the trial's own.

        Args:
            group: Index among the groups that the policy reads; each has its own random numbers.
        """
        self._noisy_groups = max(self._noisy_groups, group + 1)

        def noise(env: ManagerBasedRlEnv, frame: Tensor) -> Tensor:
            drawn = random.uniform(self._noise_keys[:, group], env.episode_length_buf, frame[0].numel())
            return drawn.view(frame.shape)

        return noise

    def set_up(self, env: ManagerBasedRlEnv, mask: Tensor) -> None:
        """Startup event: sets the friction of every env, and prepares its trials."""
        protocol, device, total = self.protocol, env.device, self.protocol.num_trials
        cells = [(grade, tier) for grade in protocol.grades for tier in protocol.tiers]
        mu = torch.tensor([math.tan(math.radians(grade)) + tier for grade, tier in cells], device=device)
        events.set_friction(env, mask, mu.repeat_interleave(self.parallel_trials))
        columns = 1 + self._noisy_groups  # starts, noise of each group
        keys = [random.trial_keys(protocol.seed, *cell, protocol.trials, columns) for cell in cells]
        # Every table has one more row for the envs without a trial; what they write there is never read.
        self._keys = torch.cat([*keys, torch.zeros(1, columns, dtype=torch.int64)]).to(device)  # [T + 1, columns]
        self._pending = torch.from_numpy(self._pending_trials()).to(device)  # [N, rounds + 1]
        self._round = env.zeros(dtype=torch.int64) - 1
        self._outcome = torch.zeros(total + 1, len(OUTCOMES), dtype=torch.bool, device=device)
        self._seconds, self._places = (torch.zeros(total + 1, device=device) for _ in range(2))
        self._furthest = env.zeros()  # [N] m
        self._referee = Referee(protocol, 0.5 * self.course.width, env.step_dt)
        self._recorder = TrackRecorder(
            total,
            len(self.course.segments),
            env.step_dt,
            robot=env.robot,
            length=self.course.length,
            device=device,
        )
        self._read_moment = MomentReader(env)
        self._moments = MomentTable(total, env.step_dt, device)

    def start(self, env: ManagerBasedRlEnv, mask: Tensor) -> None:
        """Reset event: the envs in `mask` take their next trial, and its start."""
        protocol, start, joints = self.protocol, env.start_qpos, env.robot.num_joints
        last = self._pending.shape[1] - 1
        self._round = (self._round + mask).clamp(max=last)
        self.trial = self._pending.gather(1, self._round[:, None])[:, 0]
        self.running = self.trial < self._idle
        keys = self._keys[self.trial]  # [N, columns]
        start_key, self._noise_keys = keys[:, 0], keys[:, 1:]
        draws = 2.0 * random.uniform(start_key, torch.zeros_like(start_key), 2 + joints) - 1.0  # [N, 2 + J]
        start[:, 0] = env.tiles.origin_w[:, 0] + protocol.start_place + protocol.start_along * draws[:, 0]
        start[:, 1] = env.tiles.origin_w[:, 1]
        start[:, 2] += env.terrain.height(start[:, :2]) + LIFT
        start[:, 3:7] = quaternion.from_yaw(math.radians(protocol.start_yaw) * draws[:, 1])
        moved = start[:, 7:] + protocol.start_joints * draws[:, 2:]
        start[:, 7:] = torch.clamp(moved, env.joint_range[:, 0], env.joint_range[:, 1])
        self._referee.reset(mask)
        self._furthest = torch.where(mask, start[:, 0] - env.tiles.origin_w[:, 0], self._furthest)

    def judge(self, env: ManagerBasedRlEnv) -> Tensor:
        """Termination: trials that end now, bool [N]."""
        signals = env.signals
        verdict = self._referee.judge(
            Situation(
                place=self._place(env),
                across=signals.root_pos_w[:, 1] - env.tiles.origin_w[:, 1],
                com_height=signals.com_height,
                upright=-signals.projected_gravity_b[:, 2],
                upper_force=signals.upper_force,
                diverged=env.diverged,
                steps=env.episode_length_buf,
            )
        )
        self._verdict = verdict & self.running[:, None]  # [N, outcomes]
        return self._verdict.any(dim=1)

    def record(self, env: ManagerBasedRlEnv) -> None:
        """Observer: records the instant, and the trials that `judge` has just ended."""
        place = self._place(env)
        valid = self.running & ~env.diverged
        sample = StepSample.read(env, self._recorder.legs, place, self.course.segment_at(place))
        self._recorder.add(self.trial, sample, valid)
        self._moments.add(self.trial, self._read_moment(env), valid)
        self._furthest = torch.where(valid, torch.maximum(self._furthest, place), self._furthest)
        row = torch.where(self._verdict.any(dim=1), self.trial, self._idle)
        self._outcome[row] = self._verdict
        self._seconds[row] = env.episode_length_buf * env.step_dt
        self._places[row] = self._furthest

    def trials(self) -> HeldOutTrials:
        """All trials as far as they are finished. Waits for the device."""
        total, protocol = self._idle, self.protocol
        outcome = dict(zip(OUTCOMES, self._outcome[:total].cpu().numpy().T, strict=True))
        cell = np.arange(total) // protocol.trials
        new = HeldOutTrials(
            metrics=self._recorder.trials(),
            **outcome,
            seconds=to_host(self._seconds[:total]),
            max_place=to_host(self._places[:total]),
            grade_index=cell // len(protocol.tiers),
            tier_index=cell % len(protocol.tiers),
            moments=self._moments.moments(outcome["fell"]),
        )
        if self.earlier is None:
            return new
        earlier = self.earlier.with_moments(self._moments.length)
        return map_arrays(partial(where_arrays, earlier.finished), earlier, new)

    def progress(self) -> float:
        """Share of all trials that is done, in [0, 1]; a running trial counts by its place. Waits for the device."""
        finished = self.trials().finished.sum()
        share = (self._furthest / self.protocol.success_place).clamp(0.0, 1.0)
        return float((finished + (share * self.running).sum()) / self._idle)

    def _place(self, env: ManagerBasedRlEnv) -> Tensor:
        """Root along the course, [N] m."""
        return env.signals.root_pos_w[:, 0] - env.tiles.origin_w[:, 0]

    def _pending_trials(self) -> NDArray[np.int64]:
        """Unfinished trials of each env in their order, [N, rounds + 1], padded with the idle one."""
        protocol, parallel = self.protocol, self.parallel_trials
        done = np.zeros(self._idle, dtype=bool) if self.earlier is None else self.earlier.finished
        rounds = -(-protocol.trials // parallel)
        table = np.full((protocol.num_cells * parallel, rounds + 1), self._idle, dtype=np.int64)
        for env, row in enumerate(table):
            cell, first = divmod(env, parallel)
            own = cell * protocol.trials + np.arange(first, protocol.trials, parallel)
            left = own[~done[own]]
            row[: len(left)] = left
        return table


def held_out_env_cfg(task_env: EnvCfg, scheduler: TrialScheduler, groups: Sequence[str] = ("actor",)) -> EnvCfg:
    """A task's environment reduced to its robot, its actions and the observations of the policy, on the course.

    Nothing else of the task is kept: not its rewards, terminations, events or curriculum, and of its command only the
    form (`VelocityCommandCfg.on_course`).

    Args:
        groups: Observation groups that the policy reads.

    Raises:
        UserError: If the protocol's physics step does not divide the task's control step, or the task does not have one
            of the groups.
    """
    protocol = scheduler.protocol
    observations = policy_observations(task_env, groups, enable_corruption=protocol.noise)
    for i, name in enumerate(groups):
        getattr(observations, name).noise_source = scheduler.noise_source(i)
    return EnvCfg(
        scene=dataclasses.replace(task_env.scene, terrain=scheduler.course.ground(protocol.grades)),
        sim=measuring_physics(task_env.sim, protocol.timestep, "evaluate"),
        num_envs=protocol.num_cells * scheduler.parallel_trials,
        episode_length_s=protocol.timeout_s,
        seed=protocol.seed,
        actions=task_env.actions,
        command=task_env.command.on_course(
            VelocityCommandCfg(
                speed=(protocol.speed,) * 2,
                lateral=(0.0, 0.0),
                heading_share=1.0,
                heading_gain=protocol.heading_gain,
                lateral_gain=protocol.lateral_gain,
                yaw_rate_limit=protocol.yaw_rate_limit,
                standing_share=0.0,
            )
        ),
        observations=observations,
        terminations=Terms(trial=TerminationTermCfg(scheduler.judge)),
        events=Terms(
            set_up=EventTermCfg(scheduler.set_up, mode="startup"),
            start=EventTermCfg(scheduler.start),
        ),
    )


# On one thread the results do not depend on the number of threads (see `rollout`).
@on_one_thread
@torch.inference_mode()
def run_trials(
    env: ManagerBasedRlEnv,
    policy: Callable[[TensorDict], Tensor],
    scheduler: TrialScheduler,
    on_step: Callable[[Tensor], None] = lambda running: None,
) -> HeldOutTrials:
    """Runs every unfinished trial of `scheduler` in an environment made by `held_out_env_cfg`.

    Args:
        on_step: Called after every control step with the envs [N] that took it.
    """
    env.observers.append(scheduler.record)
    try:
        while bool(scheduler.running.any()):
            running = scheduler.running
            env.step(policy(env.get_observations()), running)
            on_step(running)
    finally:
        env.observers.remove(scheduler.record)
    return scheduler.trials()
