"""Samples of the swing leg's hip flexion while a policy walks up and down ramps.

The conditions are those of the ramp check: planar ramps of fixed friction, no noise, pushes, harness or curriculum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.evaluation.common import rollout, to_host
from humoslope.evaluation.ramps import APPROACH, Grades, RampProtocol
from humoslope.mdp.bsga import HIP_PITCH
from humoslope.mdp.bsga_memory import SWING_FORCE, SWING_LONGEST, SWING_SETTLE, Swing
from humoslope.mdp.selection import joint_pair
from humoslope.ranges import Count, NotNegative, Positive
from humoslope.statistics import Array

CLEAR = 1.0
"""Distance on a ramp before samples count, m: a few strides, and the whole height scan is on the ramp."""
SPEED_WINDOW = 1.0
"""Time constant of the mean speed, s: about a stride, so that trials are excluded and not phases of a stride."""


@dataclass(frozen=True)
class SwingProtocol(RampProtocol):
    """Settings of the calibration's ramps, and of the instants that count as swing.

    Attributes:
        grades: Grades of the ramps, degrees; negative goes down. Every 2.5, one for each bin of the fit.
        starts: Trials on each ramp.
        seconds: Length of a trial, s; in the first 4 or 5 the robot gets well onto its ramp.
        hip: Regular expression for the whole names of the joints that flex the hips, one on the left and one on the
            right, turning about the left axis; as in the swing reward.
        swing_force: Force on the ground below which a foot swings, N.
        swing_settle: Time after lift-off from which a swing counts, s.
        swing_longest: Time after lift-off from which a swing no longer counts, s.
        speed_tolerance: Largest difference of the mean speed from the commanded one at which samples count, m/s.
    """

    VERB: ClassVar[str] = "calibrate"

    grades: Grades = tuple(2.5 * i for i in range(-12, 13))
    starts: Count = 32
    speed: Positive = 0.5
    seconds: Positive = 15.0
    # The law is that of straight walks.
    lateral: float = field(default=0.0, init=False)
    yaw_rate: float = field(default=0.0, init=False)
    across: bool = field(default=False, init=False)
    push: float = field(default=0.0, init=False)
    push_every: float = field(default=5.0, init=False)
    hip: str = HIP_PITCH
    swing_force: Positive = SWING_FORCE
    swing_settle: NotNegative = SWING_SETTLE
    swing_longest: NotNegative = SWING_LONGEST
    speed_tolerance: Positive = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.swing_settle > self.swing_longest:
            raise UserError(
                f"calibrate: no swing counts from {self.swing_settle:g} to {self.swing_longest:g} s after lift-off; "
                "swing_longest must be no less than swing_settle."
            )


@dataclass(frozen=True)
class SwingSamples:
    """K instants of a swinging leg, on the host.

    Attributes:
        slope: [K] inclination of the ground in the heading direction, rad, positive uphill.
        flexion: [K] flexion of that leg's hip, rad.
    """

    slope: Array
    flexion: Array

    def __len__(self) -> int:
        return len(self.slope)


class SwingRecorder:
    """Collects samples step by step; an env whose trial has ended is ignored. Nothing waits for the device.

    Args:
        protocol: Commanded speed and its tolerance.
        num_envs: Number of envs N.
        dt: Control step, s.
        device: Device of the signals.
    """

    def __init__(self, protocol: SwingProtocol, num_envs: int, dt: float, device: torch.device) -> None:
        self._protocol = protocol
        self._keep_speed = float(np.exp(-dt / SPEED_WINDOW))
        self._running = torch.ones(num_envs, dtype=torch.bool, device=device)
        self._speed = torch.zeros(num_envs, device=device)  # [N] m/s; a robot from rest counts only later
        self._slope: list[Tensor] = []
        self._flexion: list[Tensor] = []
        self._counts: list[Tensor] = []

    def add(
        self,
        place: Tensor,
        speed: Tensor,
        slope: Tensor,
        flexion: Tensor,
        swinging: Tensor,
        failed: Tensor,
        ended: Tensor,
    ) -> None:
        """Adds one control step.

        Args:
            place: [N] along the tile, m.
            speed: [N] forward along the ground, m/s.
            slope: [N] slope of the ground in the heading direction, rad.
            flexion: [N, 2] flexion of left and right hip, rad.
            swinging: [N, 2] bool; legs that swing.
            failed, ended: [N] bool.
        """
        protocol = self._protocol
        self._running = self._running & ~failed & ~ended
        self._speed = torch.lerp(speed, self._speed, self._keep_speed)
        steady = (self._speed - protocol.speed).abs() < protocol.speed_tolerance
        walking = self._running & steady & (place >= APPROACH + CLEAR)
        self._slope.append(slope)
        self._flexion.append(flexion)
        self._counts.append(walking[:, None] & swinging)

    def samples(self) -> SwingSamples:
        """The samples so far. Waits for the device."""
        if not self._counts:
            return SwingSamples(np.empty(0), np.empty(0))
        counts = torch.stack(self._counts)  # [T, N, 2]
        slope = torch.stack(self._slope)[:, :, None].expand_as(counts)
        return SwingSamples(
            slope=to_host(slope[counts]),
            flexion=to_host(torch.stack(self._flexion)[counts]),
        )


def collect_samples(
    env: ManagerBasedRlEnv,
    policy: Callable[[TensorDict], Tensor],
    protocol: SwingProtocol,
    on_step: Callable[[], None] = lambda: None,
) -> SwingSamples:
    """Samples of one trial in every env of an environment made by `ramp_env_cfg`.

    Args:
        on_step: Called after every control step.

    Raises:
        UserError: If the robot does not have the hip joints of the protocol.
    """
    recorder = SwingRecorder(protocol, env.num_envs, env.step_dt, env.device)
    swing = Swing(env, protocol.swing_force, protocol.swing_settle, protocol.swing_longest)
    hips = joint_pair(env.robot, protocol.hip, env.device)
    signals, start_x = env.signals, env.tiles.origin_w[:, 0]

    def observe(failed: Tensor, ended: Tensor) -> None:
        recorder.add(
            place=signals.root_pos_w[:, 0] - start_x,
            speed=signals.root_lin_vel_t[:, 0],
            slope=env.height_scan.descriptor.slope,
            flexion=-signals.joint_pos.index_select(1, hips),
            swinging=swing.step(env),
            failed=failed,
            ended=ended,
        )

    rollout(env, policy, protocol.seconds, observe, on_step)
    return recorder.samples()
