"""The slope-adaptive ZMP regulariser as a reward (paper, section 3.1)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import torch
from torch import Tensor

from humoslope.managers.terms import StatefulTerm
from humoslope.mdp.rate import RateOfChange
from humoslope.ranges import Limit, Positive, Range, Share
from humoslope.slope import zmp

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


class ZmpRegulariser(StatefulTerm):
    """Reward exp(-d_zmp / sigma) for a zero-moment point close to the support anchor.

    The paper gives the structure but no numbers, and takes the CoM's acceleration as it is. The values of `sigma` and
    `epsilon` are ours, and so are filtering and clipping of the acceleration, the least pressure, the cut of the
    deviation and the hold of the normal in flight: a simulated contact makes single accelerations meaningless.

    Args:
        sigma: Deviation at which the reward has fallen to 1/e, m. 0.10 is about half a foot. Ours.
        epsilon: Force added to both feet in the anchor's weights, N. Ours.
        smoothing: Weight of the past in the moving average of the CoM's acceleration. Ours.
        acc_limit: Bound on each component of the CoM's acceleration before it is averaged, m/s^2. Ours.
        least_pressure: Smallest apparent force on the plane for which a ZMP is defined, m/s^2; below it the reward is
            zero. Ours.
        largest_deviation: Bound on the deviation, m. Ours.
        flight_share: Share of body weight on the feet below which the last support normal is held. Ours.
        plane: "support" for the plane of the foot with more load (the paper's regulariser), "horizontal" for the
            horizontal plane through the anchor, which the paper argues against.

    Attributes:
        anchor, normal, point: [N, 3] support anchor, normal of the support plane and zero-moment point of the last
            call.
        valid: [N] bool; True where that point was defined.
    """

    def __init__(
        self,
        env: Env,
        sigma: Positive = 0.10,
        epsilon: Positive = 1.0,
        smoothing: Annotated[float, Range(0.0, 1.0, open_high=True)] = 0.5,
        acc_limit: Limit = 20.0,
        least_pressure: Positive = 2.0,
        largest_deviation: Limit = 0.5,
        flight_share: Share = 0.1,
        plane: Literal["support", "horizontal"] = "support",
    ) -> None:
        self._sigma, self._epsilon = sigma, epsilon
        self._smoothing, self._acc_limit = smoothing, acc_limit
        self._least_pressure, self._largest_deviation = least_pressure, largest_deviation
        self._flight_force = flight_share * env.robot.total_mass * zmp.GRAVITY
        self._horizontal = plane == "horizontal"
        self._rate = RateOfChange(env.step_dt)
        self._com_acc = env.zeros(3)  # [N, 3] m/s^2
        self._up = torch.tensor([0.0, 0.0, 1.0], device=env.device).expand(env.num_envs, 3)
        self._normal = self._up

    def __call__(self, env: Env) -> Tensor:
        signals = env.signals
        raw = self._rate(signals.com_lin_vel_w).clamp(-self._acc_limit, self._acc_limit)
        self._com_acc = torch.lerp(raw, self._com_acc, self._smoothing)
        self.anchor = zmp.support_anchor(signals.foot_pos_w, signals.foot_force, self._epsilon)
        self.normal = self._plane_normal(env, signals.foot_force)
        self.point, self.valid = zmp.zero_moment_point(
            signals.com_pos_w, self._com_acc, self.anchor, self.normal, self._least_pressure
        )
        deviation = (self.point - self.anchor).norm(dim=1)
        return torch.exp(-deviation.clamp(max=self._largest_deviation) / self._sigma) * self.valid

    def _plane_normal(self, env: Env, force: Tensor) -> Tensor:
        if self._horizontal:
            return self._up
        supported = (force.sum(dim=1) >= self._flight_force)[:, None]
        self._normal = torch.where(supported, zmp.dominant_normal(env.signals.foot_normal_w, force), self._normal)
        return self._normal

    def reset(self, mask: Tensor) -> None:
        """Clears acceleration and support plane of the envs in `mask`."""
        self._rate.reset(mask)
        self._com_acc = self._com_acc.masked_fill(mask[:, None], 0.0)
        self._normal = torch.where(mask[:, None], self._up, self._normal)
