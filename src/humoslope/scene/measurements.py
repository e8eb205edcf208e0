"""Readings of the robot's own sensors, with the errors and the age that they have on a real robot."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from humoslope.errors import UserError
from humoslope.memory import require_memory
from humoslope.scene.drives import Drives
from humoslope.scene.signals import Signals
from humoslope.sim.protocol import Simulation

ROUNDING = 1e-4
"""Fraction of a physics step that is rounding, not age."""


class Measurements:
    """Joint encoders and IMU of each env as the robot's computer reads them.

    Without errors and at an age of one physics step, which `mj_step` gives by itself, they equal the signals of the
    same names. Older readings are kept per physics step and interpolated linearly, so that an age in seconds is the
    same whatever the physics step. MuJoCo's own sensor delay is not used: the rewards read the same sensors undelayed,
    so every sensor would be there twice, and each reset would need a second forward pass to fill the buffers.

    Attributes:
        age_s: [N] age of the readings at the moment when the policy sees them, s.
        gyro_bias: [N, 3] offset of the gyroscope, rad/s.
        imu_rotation: [N, 3, 3] rotation from the IMU's axes to those of the root.
    """

    def __init__(
        self, sim: Simulation, signals: Signals, drives: Drives, timestep: float, age_s: float | None = None
    ) -> None:
        """Args:
            timestep: Physics step, s.
            age_s: Age of all readings at first, s; one physics step by default.

        Raises:
            UserError: If the age is shorter than a physics step.
        """
        self._sim, self._signals, self._drives, self._timestep = sim, signals, drives, timestep
        age = timestep if age_s is None else age_s
        if not timestep * (1.0 - ROUNDING) <= age < math.inf:
            raise UserError(
                f"sim.observation_age_s is {age:g}; it must be finite and at least the physics step of {timestep:g} s."
            )
        n = sim.num_worlds
        self.age_s = torch.full((n,), age, device=sim.device)
        self.gyro_bias = torch.zeros(n, 3, device=sim.device)
        self.imu_rotation = torch.eye(3, device=sim.device).repeat(n, 1, 1)
        self._past: list[Tensor] = []  # [N, D] each, the newest first; empty if one physics step is old enough
        self._seen: tuple[Tensor, ...] | None = None
        self.make_room(age)

    def make_room(self, age_s: float) -> None:
        """Keeps enough readings for ages of up to `age_s`. Must be called before such an age is set."""
        steps = math.ceil(age_s / self._timestep - ROUNDING)
        if steps > max(1, len(self._past)):
            kept = sum(value.shape[1] for value in self._present())
            # Kept once, and once more while a moment between two of them is found; in single precision.
            each = 2 * 4 * self._sim.num_worlds * kept
            require_memory("the number of past readings", steps, each, device=self._sim.device)
            last = self._past[-1] if self._past else self._signals.own_sensors()
            self._past += [last] * (steps - len(self._past))

    def advance(self, n: int, mask: Tensor | None = None) -> None:
        """Steps the physics `n` times (see `Simulation.step`) and keeps the readings on the way."""
        kept = min(n, len(self._past))
        if n > kept:
            self._sim.step(n - kept, mask)
        for _ in range(kept):
            self._sim.step(1, mask)
            self._past = [self._signals.own_sensors(), *self._past[:-1]]
        self._seen = None

    def reset(self, mask: Tensor) -> None:
        """Forgets what the envs in `mask` [N] read before their present reading. Called after the signals' refresh."""
        if self._past:
            now = self._signals.own_sensors()
            self._past = [torch.where(mask[:, None], now, past) for past in self._past]
        self._seen = None

    @property
    def joint_pos(self) -> Tensor:
        """[N, J] joint positions, rad."""
        return self._at_age()[0] + self._drives.encoder_bias

    @property
    def joint_vel(self) -> Tensor:
        """[N, J] joint velocities, rad/s."""
        return self._at_age()[1]

    @property
    def root_ang_vel_b(self) -> Tensor:
        """[N, 3] angular velocity in the axes of the IMU, rad/s."""
        return self._in_imu(self._at_age()[2]) + self.gyro_bias

    @property
    def projected_gravity_b(self) -> Tensor:
        """[N, 3] direction of gravity in the axes of the IMU."""
        return self._in_imu(self._at_age()[3])

    def _in_imu(self, v: Tensor) -> Tensor:
        return (self.imu_rotation * v[:, :, None]).sum(dim=1)

    def _present(self) -> tuple[Tensor, ...]:
        signals = self._signals
        return signals.joint_pos, signals.joint_vel, signals.root_ang_vel_b, signals.projected_gravity_b

    def _at_age(self) -> tuple[Tensor, ...]:
        """True values of the moment that is seen, computed once per step."""
        if not self._past:
            return self._present()
        if self._seen is None:
            place = (self.age_s / self._timestep - 1.0).clamp(0.0, len(self._past) - 1.0)
            steps = torch.arange(len(self._past), device=place.device)
            weight = (1.0 - (place - steps[:, None]).abs()).clamp(min=0.0)  # [H, N]
            mean = (torch.stack(self._past) * weight[:, :, None]).sum(dim=0)  # [N, D]
            self._seen = mean.split([value.shape[1] for value in self._present()], dim=1)
        return self._seen
