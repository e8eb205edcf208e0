"""Masses of the links, which may differ between envs."""

from __future__ import annotations

import torch
from torch import Tensor

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
