"""The critics: a distribution over returns on a fixed support (C51, Bellemare et al. 2017), twice."""

from __future__ import annotations

from typing import NamedTuple

import torch
from rsl_rl.modules import MLP
from torch import Tensor, nn


class Support(NamedTuple):
    """Returns ("atoms") over which distributions are given, evenly spaced.

    Attributes:
        atoms: [A], ascending.
    """

    atoms: Tensor

    @classmethod
    def of(cls, v_min: float, v_max: float, num_atoms: int, device: torch.device | str) -> Support:
        """`num_atoms` atoms from `v_min` to `v_max`."""
        return cls(torch.linspace(v_min, v_max, num_atoms, device=device))

    def mean(self, probabilities: Tensor) -> Tensor:
        """Expected return [...] of distributions [..., A]."""
        return probabilities @ self.atoms

    def end_mass(self, probabilities: Tensor) -> Tensor:
        """Mean mass of distributions [..., A] in their two end atoms, which hold what lies beyond the support, too."""
        return (probabilities[..., 0] + probabilities[..., -1]).mean()

    def project(self, probabilities: Tensor, reward: Tensor, discount: Tensor) -> Tensor:
        """Distributions of `reward + discount * return`, on the same support.

        The mass of a return between two atoms goes to both, the nearer one taking more, so that its mean is kept; what
        lies beyond the support goes to its end.

        Args:
            probabilities: [..., B, A] distributions of the return.
            reward: [B].
            discount: [B].

        Returns:
            [..., B, A].
        """
        atoms, last = self.atoms, len(self.atoms) - 1
        low, high = atoms[0], atoms[-1]
        moved = (reward[:, None] + discount[:, None] * atoms).clamp(low, high)  # [B, A]
        place = (moved - low) * (last / (high - low))
        # The lower neighbour of the last atom is the one before it: an atom is never its own neighbour, which would
        # count its mass twice.
        lower = place.floor().clamp(0, last - 1)
        share = (place - lower).expand_as(probabilities)  # of the mass that goes to the upper neighbour
        index = lower.to(torch.int64).expand_as(probabilities)
        projected = torch.zeros_like(probabilities)
        projected.scatter_add_(-1, index, probabilities * (1.0 - share))
        return projected.scatter_add_(-1, index + 1, probabilities * share)


class Critics(nn.Module):
    """Two critics of the same shape, each an MLP with ReLU from observation and action to a distribution.

    Args:
        num_obs: Size of an observation, which they get normalised.
        num_actions: Size of an action in [-1, 1].
        hidden_dims: Widths of the hidden layers.
        num_atoms: Number of atoms of the support.
    """

    def __init__(self, num_obs: int, num_actions: int, hidden_dims: tuple[int, ...], num_atoms: int) -> None:
        super().__init__()
        self.first, self.second = (MLP(num_obs + num_actions, num_atoms, hidden_dims, "relu") for _ in range(2))

    def forward(self, obs: Tensor, action: Tensor) -> Tensor:
        """Logits [2, B, A] for `obs` [B, d] and `action` [B, J]."""
        both = torch.cat([obs, action], dim=1)
        return torch.stack([self.first(both), self.second(both)])
