"""Helpers of the terrain tests."""

from __future__ import annotations

import torch

import terrains  # noqa: F401  registers the kinds
from humoslope.terrain import TerrainQueries, registry

TRAINING = tuple(name for name in registry.names() if registry.find(name).training)
"""Names of the terrains that training may use."""

STRAIGHT = tuple(name for name in TRAINING if not registry.find(name).omnidirectional)
"""Those whose tiles are walked from their start along x."""


def normal(queries: TerrainQueries, xy: torch.Tensor, radius: float = 0.003) -> torch.Tensor:
    """Unit normal of the ground at points [..., 2], from heights at a small distance around them."""
    return queries.slope_normal(queries.height(queries.around(xy, radius)), radius)
