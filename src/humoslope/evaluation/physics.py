"""The physics that policies are measured with, however they were trained."""

from __future__ import annotations

import dataclasses

from humoslope.env import SimCfg
from humoslope.errors import UserError


def measuring_physics(sim: SimCfg, timestep: float, verb: str) -> SimCfg:
    """The same control step in finer physics steps, with the elliptic friction cone.

    Args:
        timestep: Physics step, s.
        verb: Who asks, for the message.

    Raises:
        UserError: If it does not divide the control step.
    """
    period = sim.timestep * sim.decimation
    decimation = round(period / timestep)
    if decimation < 1 or abs(decimation * timestep - period) > 1e-9:
        raise UserError(f"{verb}: timestep {timestep:g} s does not divide the task's control step of {period:g} s.")
    return dataclasses.replace(sim, timestep=timestep, decimation=decimation, cone="elliptic")
