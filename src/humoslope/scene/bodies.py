"""Poses of a robot's bodies by name, for terms that need others than those of the named signals."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mujoco
from torch import Tensor

from humoslope.errors import UserError, unknown
from humoslope.sim.protocol import Simulation
from humoslope.slope import quaternion


class Bodies:
    """Positions and orientations of all bodies, all of the instant of the signals.

    They are read from the physics only if a term asks for them, since every reading costs a copy in each step. A term
    asks with `@reads_bodies`. The values are views that the next step overwrites.
    """

    def __init__(self, sim: Simulation, funcs: Iterable[Any]) -> None:
        """Args:
        funcs: Functions and classes of the environment's terms.
        """
        self._model = sim.model
        self._read = any(getattr(func, "reads_bodies", False) for func in funcs)
        if self._read:
            self._position = sim.read("xpos")  # [N, bodies, 3]
            self._quat = sim.read("xquat")  # [N, bodies, 4]

    def position(self, name: str) -> Tensor:
        """Position of a body in the world frame, [N, 3] m.

        Raises:
            UserError: If there is no such body, or no term has asked for bodies.
        """
        body = self._id(name)
        return self._position[:, body]

    def rotation(self, name: str) -> Tensor:
        """Rotation of a body, body frame to world frame, [N, 3, 3].

        Raises:
            UserError: As `position`.
        """
        body = self._id(name)
        return quaternion.matrix(self._quat[:, body])

    def _id(self, name: str) -> int:
        if not self._read:
            raise UserError("no term of this environment reads bodies; decorate the one that does with @reads_bodies.")
        found = int(mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_BODY, name))
        if found < 0:
            raise unknown("body", name, [self._model.body(i).name for i in range(1, self._model.nbody)])
        return found
