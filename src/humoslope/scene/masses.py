"""Masses of the links, which may differ between envs."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from humoslope.errors import UserError
from humoslope.sim.fields import replace
from humoslope.sim.protocol import Simulation


class Masses:
    """Mass of every body in each env: factor x the model's mass + an added mass. Its inertia scales with it.

    One place holds both, since different events draw them and either may come last.

    Attributes:
        factor: [N, nbody] factors on the masses of the model.
        added: [N, nbody] added masses, kg.
        nominal_com: [nbody, 3] centres of mass of the model, in the frames of the bodies, m.
    """

    def __init__(self, sim: Simulation) -> None:
        self._sim = sim
        self._mass = torch.as_tensor(sim.model.body_mass, dtype=torch.float32, device=sim.device)  # [nbody]
        self._inertia = torch.as_tensor(sim.model.body_inertia, dtype=torch.float32, device=sim.device)  # [nbody, 3]
        self.nominal_com = torch.as_tensor(sim.model.body_ipos, dtype=torch.float32, device=sim.device)
        self.factor = torch.ones(sim.num_worlds, len(self._mass), device=sim.device)
        self.added = torch.zeros_like(self.factor)
        self._model = sim.model
        self._least_factor, self._least_added = np.ones(sim.model.nbody), np.zeros(sim.model.nbody)

    def expect(self, bodies: slice, *, factor: float = 1.0, added: float = 0.0) -> None:
        """Notes the lowest factor on masses, or the lowest added mass in kg, that an event draws for some bodies.

        Raises:
            UserError: If a body could come to weigh nothing, or less.
        """
        if factor != 1.0:
            self._least_factor[bodies] = factor
        if added != 0.0:
            self._least_added[bodies] = added
        mass = self._model.body_mass
        for body in np.flatnonzero((mass > 0.0) & (mass * self._least_factor + self._least_added <= 0.0)):
            share = "" if self._least_factor[body] == 1.0 else f"{self._least_factor[body]:g} of "
            raise UserError(
                f"{self._model.body(body).name} weighs {mass[body]:.3g} kg; {self._least_added[body]:g} kg cannot be "
                f"added to {share}it."
            )

    def set(self, mask: Tensor, bodies: slice, *, factor: Tensor | None = None, added: Tensor | None = None) -> None:
        """Changes the factors or the added masses [N, bodies] of the envs in `mask` [N], and what follows from them."""
        for values, change in ((self.factor, factor), (self.added, added)):
            if change is not None:
                values[:, bodies] = torch.where(mask[:, None], change, values[:, bodies])
        mass = self._mass[bodies] * self.factor[:, bodies] + self.added[:, bodies]
        share = mass / self._mass[bodies].clamp(min=torch.finfo(torch.float32).tiny)  # a frame has neither
        fields = {"body_mass": mass, "body_inertia": self._inertia[bodies] * share[:, :, None]}
        for name, value in fields.items():
            replace(self._sim.expand(name)[:, bodies], mask, value)
        self._sim.recompute_constants()
