"""Calibrated hip-pitch reference of the swing leg (paper, equation swing_calibration)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from torch import Tensor

from humoslope.errors import UserError


@dataclass(frozen=True)
class SwingCalibration:
    """Coefficients of the hip-pitch reference.

    Attributes:
        beta0: Hip flexion on flat ground and downhill, rad.
        beta1: Flexion added per inclination, rad/rad.
        theta_clip: Inclination from which no more is added, rad.

    Raises:
        UserError: If a coefficient is not finite, or theta_clip is not between 0 and pi/2.
    """

    beta0: float
    beta1: float
    theta_clip: float

    def __post_init__(self) -> None:
        for name in ("beta0", "beta1"):
            if not math.isfinite(getattr(self, name)):
                raise UserError(f"swing calibration: {name} is {getattr(self, name)}; it must be finite.")
        if not 0.0 < self.theta_clip < 0.5 * math.pi:
            raise UserError(
                f"swing calibration: theta_clip is {self.theta_clip:g} rad; it must be between 0 and pi/2, exclusive."
            )

    def target(self, slope: Tensor) -> Tensor:
        """Target hip flexion in swing, beta0 + beta1 clip(slope, 0, theta_clip), in the shape of `slope`, rad.

        Flexion counts forward from the standing leg: it is the negative angle of a hip pitch joint about the left axis.

        Args:
            slope: Inclination of the ground in the heading direction, rad, positive uphill.
        """
        return self.beta0 + self.beta1 * slope.clamp(0.0, self.theta_clip)


PRIOR = SwingCalibration(beta0=0.45, beta1=1.0, theta_clip=math.radians(30.0))
"""Calibration without a measurement. The paper gives no numbers; these are ours. On a slope the foot must come
down higher by about the angle of the ground, so the hip flexes by as much more (beta1 = 1); beta0 lies a little above
the flexion that the Unitree G1 stands with (0.31 rad); theta_clip is the steepest grade of the paper's benchmark."""
