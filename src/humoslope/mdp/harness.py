"""The training harness: an assistive wrench that carries and uprights the robot, and the curriculum that takes it away.

With it a policy meets walking before it has learnt to stand; without it, on few samples, it only ever stands still.
It exists in training alone: no evaluation configures it, and a run that used it logs its strength.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from humoslope.errors import UserError
from humoslope.managers.terms import StatefulTerm
from humoslope.slope import quaternion, zmp

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


class Harness(StatefulTerm):
    """Step event: an upward force on the root and an uprighting torque on the torso, scaled by `scale` in [0, 1].

    Args:
        support: Upward force at full scale, as a share of body weight.
        stiffness: Torque about the horizontal axes per sine of the torso's lean, Nm.
        damping: Torque against the torso's horizontal angular velocity, Nm s/rad.
        scale: Where it starts.
    """

    def __init__(
        self, env: Env, support: float = 0.35, stiffness: float = 120.0, damping: float = 3.0, scale: float = 1.0
    ) -> None:
        if not 0.0 <= scale <= 1.0:
            raise UserError(f"harness: scale {scale} must be between 0 and 1.")
        self.scale = torch.tensor(scale, device=env.device)
        self._lift = support * env.robot.total_mass * zmp.GRAVITY  # N
        self._stiffness, self._damping = stiffness, damping
        wrench = env.sim.state("xfrc_applied")  # [N, bodies, 6]: force, torque; world frame
        self._root = wrench[:, env.body_id(env.robot.root_body)]
        self._torso = wrench[:, env.body_id(env.robot.torso_body)]
        self._up = torch.tensor([[0.0, 0.0, 1.0]], device=env.device)

    def __call__(self, env: Env, mask: Tensor) -> None:
        torso_up_w = quaternion.matrix(env.signals.torso_quat_w)[:, :, 2]
        uprighting = self._stiffness * torch.linalg.cross(torso_up_w, self._up)
        torque = torch.sub(uprighting, env.signals.torso_ang_vel_w, alpha=self._damping)
        self._root[:, 2].copy_(self._lift * self.scale)
        self._torso[:, 3:5].copy_(torque[:, :2] * self.scale)

    def reset(self, mask: Tensor) -> None:
        """Nothing is remembered: the physics clears the wrench of a world that starts anew."""


class HarnessCurriculum(StatefulTerm):
    """Curriculum: the harness is taken away while the robots hardly fall and really walk.

    Args:
        event: Name of the `Harness` event.
        rate: Scale taken away per second of training time in one world. 0.0083 is 0.004 in a rollout of 24 steps of 20
            ms.
        falls_per_second: Falls per world and second above which it is left as it is.
        speed_share: Share of the commanded speed below which it is left as it is: standing still in the harness is no
            skill.
        memory_s: Time over which both are averaged, s.
    """

    def __init__(
        self,
        env: Env,
        event: str = "harness",
        rate: float = 0.0083,
        falls_per_second: float = 0.04,
        speed_share: float = 0.7,
        memory_s: float = 10.0,
    ) -> None:
        harness = env.events[event]
        if not isinstance(harness, Harness):
            raise UserError(f"harness curriculum: event '{event}' is not a Harness.")
        self._harness, self._rate = harness, rate
        self._most_falls, self._least_speed = falls_per_second, speed_share
        self._keep = 1.0 - env.step_dt / memory_s
        # Starts as if everyone fell and nobody walked,
        # so that nothing is withdrawn before the robots have proven themselves.
        self._falls = torch.ones((), device=env.device)  # per second
        self._speed = torch.zeros((), device=env.device)  # share of the commanded one

    @property
    def scale(self) -> Tensor:
        """Present scale of the harness."""
        return self._harness.scale

    def __call__(self, env: Env, mask: Tensor) -> Tensor:
        falls = env.terminations.terminated.mean(dtype=torch.float32) / env.step_dt
        asked, walked = env.commands.velocity[:, 0], env.signals.root_lin_vel_t[:, 0]
        speed = (walked * (asked > 0.0)).sum() / asked.sum().clamp(min=1e-6)
        self._falls = torch.lerp(falls, self._falls, self._keep)
        self._speed = torch.lerp(speed, self._speed, self._keep)
        able = (self._falls < self._most_falls) & (self._speed > self._least_speed)
        self._harness.scale = (self._harness.scale - self._rate * env.step_dt * able).clamp(min=0.0)
        return self._harness.scale

    def reset(self, mask: Tensor) -> None:
        """Nothing belongs to a single world."""

    def state_dict(self) -> dict[str, Any]:
        """Scale, fall rate and speed."""
        return {"scale": self._harness.scale.item(), "falls": self._falls.item(), "speed": self._speed.item()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues where `state_dict` was taken."""
        self._harness.scale = torch.tensor(state["scale"], device=self._falls.device)
        self._falls = torch.tensor(state["falls"], device=self._falls.device)
        self._speed = torch.tensor(state["speed"], device=self._speed.device)
