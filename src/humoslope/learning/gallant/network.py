"""Gallant's network: an encoder of proprioception, one of voxel columns, and a head over both."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import torch
from rsl_rl.modules import HiddenState
from tensordict import TensorDict
from torch import Tensor, nn

from humoslope.learning.networks import Network
from humoslope.perception.columns import ColumnGrid

GAIN, ACTION_GAIN = 0.1, 0.01
"""Gain of the orthogonal initial weights, and that of the layer that gives actions."""


class Voxels(nn.Module):
    """Cells of columns of which the height of the ground is known: 1 where the ground is, else 0."""

    def __init__(self, grid: ColumnGrid) -> None:
        super().__init__()
        self.side, self.low, self.per_metre = grid.side, grid.low, 1.0 / grid.cell
        self.register_buffer("levels", torch.arange(grid.levels, dtype=torch.float32), persistent=False)

    def forward(self, heights: Tensor) -> Tensor:
        """Cells [B, levels, side, side] of columns [B, side * side]. Levels are channels, and lie together in memory,
        as convolutions on CPUs like it best."""
        level = torch.floor((heights - self.low) * self.per_metre).unflatten(1, (self.side, self.side))
        return (level[..., None] == self.levels).to(heights.dtype).permute(0, 3, 1, 2)


class GallantNetwork(Network):
    """rsl_rl's MLP over two encodings: of the vectors of all groups but the last, and of the last, voxel columns.

    | part | layers |
    |---|---|
    | proprioception | linear, Mish, layer norm, linear |
    | voxels | three convolutions of 3 x 3 with stride 2, each with Mish; linear, Mish, layer norm, linear |
    | head | Mish; linear, Mish for each of `hidden_dims`; linear |

    Proprioception is normalised, columns are not.

    Args:
        grid: Fields of the `ColumnGrid` of the last group.
        proprioception_dim: Width of the encoder of proprioception.
        voxel_channels: Channels of each convolution.
        voxel_dim: Width of the encoder of voxels.
        variant: Remark on the network for readers of results (see `PolicySpec.variant`); no part of it.
    """

    def __init__(
        self,
        obs: TensorDict,
        obs_groups: dict[str, list[str]],
        obs_set: str,
        output_dim: int,
        grid: Mapping[str, float],
        proprioception_dim: int = 256,
        voxel_channels: int = 8,
        voxel_dim: int = 64,
        variant: str = "",
        **settings: Any,
    ) -> None:
        *vectors, self.columns = obs_groups[obs_set]
        self._latent = proprioception_dim + voxel_dim
        super().__init__(obs, {obs_set: vectors}, obs_set, output_dim, **settings)
        columns = ColumnGrid(**grid)
        if obs[self.columns].shape[1:] != (columns.side**2,):
            raise ValueError(f"group '{self.columns}' has {obs[self.columns].shape[1]} columns, not {columns.side**2}")
        self.proprioception = _encoder(self.obs_dim, proprioception_dim)
        channels = (columns.levels, *(voxel_channels,) * 3)
        convolutions: list[nn.Module] = [Voxels(columns)]
        for before, after in pairwise(channels):
            convolutions += [nn.Conv2d(before, after, 3, stride=2, padding=1), nn.Mish()]
        self.voxels = nn.Sequential(*convolutions, nn.Flatten())
        self.voxels.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # torch's types lack it
        features = self.voxels(torch.zeros(1, columns.side**2)).shape[1]
        self.ground = _encoder(features, voxel_dim)
        for module in self.modules():
            if isinstance(module, nn.Linear):
                nn.init.orthogonal_(module.weight, GAIN)
                nn.init.zeros_(module.bias)
        if self.distribution is not None:
            nn.init.orthogonal_(self.mlp[-1].weight, ACTION_GAIN)

    def get_latent(self, obs: TensorDict, masks: Tensor | None = None, hidden_state: HiddenState = None) -> Tensor:
        """Both encodings side by side, [B, proprioception_dim + voxel_dim]."""
        vectors = super().get_latent(obs, masks, hidden_state)
        ground = self.ground(self.voxels(obs[self.columns]))
        return nn.functional.mish(torch.cat([self.proprioception(vectors), ground], dim=-1))

    def _get_latent_dim(self) -> int:
        return self._latent


def _encoder(inputs: int, width: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, width), nn.Mish(), nn.LayerNorm(width), nn.Linear(width, width))
