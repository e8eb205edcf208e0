"""The networks that a policy may be, by name, and rsl_rl's MLP with less copying on the way in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from rsl_rl.models import CNNModel, MLPModel
from rsl_rl.modules import EmpiricalNormalization, HiddenState
from tensordict import TensorDict
from torch import Tensor

from humoslope.errors import UserError, unknown

MakeNetwork = Callable[..., torch.nn.Module]

_NETWORKS: dict[str, MakeNetwork] = {}


def network(name: str) -> Callable[[MakeNetwork], MakeNetwork]:
    """Registers a class or function under a name that checkpoints hold.

    It is called as `make(obs, groups, num_actions, **settings)` with an example of the observations (a `TensorDict` of
    batch size 1), the names of the groups that the policy reads, and what `PolicySpec.settings` holds. The module that
    it makes maps observations to the deterministic action [N, J].
    """

    def register(make: MakeNetwork) -> MakeNetwork:
        if _NETWORKS.setdefault(name, make) is not make:
            raise UserError(f"network '{name}' is registered twice.")
        return make

    return register


def find_network(name: str) -> MakeNetwork:
    """The network registered under `name`.

    Raises:
        UserError: If there is none.
    """
    if name not in _NETWORKS:
        raise unknown("network", name, _NETWORKS)
    return _NETWORKS[name]


CHUNK = 8192
"""Observations whose deviations are held at once."""


class Network(MLPModel):
    """`MLPModel` with the same weights and state; a single observation group is not copied.

    Args:
        least_std: Least standard deviation that observations are divided by; without it the output is `MLPModel`'s too.
    """

    def __init__(self, *args: Any, least_std: float = 0.0, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        if self.obs_normalization:
            self.obs_normalizer = Normalisation(self.obs_dim, least_std)

    def get_latent(self, obs: TensorDict, masks: Tensor | None = None, hidden_state: HiddenState = None) -> Tensor:
        """The normalised observations [B, d]."""
        latent: Tensor = self.obs_normalizer(self._input(obs))
        return latent

    def update_normalization(self, obs: TensorDict) -> None:
        """Learns the mean and the deviation of the observations."""
        if self.obs_normalization:
            self.obs_normalizer.update(self._input(obs))

    def _input(self, obs: TensorDict) -> Tensor:
        groups = [obs[name] for name in self.obs_groups]
        return groups[0] if len(groups) == 1 else torch.cat(groups, dim=-1)


class Normalisation(EmpiricalNormalization):
    """`EmpiricalNormalization` in one pass over what it normalises, and without torch's slow variance over rows.

    Args:
        shape: Shape of the input without the batch axis.
        least_std: Least standard deviation that inputs are divided by.
    """

    def __init__(self, shape: int, least_std: float = 0.0) -> None:
        super().__init__(shape)
        self.least_std = least_std

    def forward(self, x: Tensor) -> Tensor:
        """`x` [B, d] less its mean, in units of its deviation."""
        scale = 1.0 / (self._std.clamp(min=self.least_std) + self.eps)
        return torch.addcmul(-self._mean * scale, x, scale)

    @torch.jit.unused
    def update(self, x: Tensor) -> None:
        """Takes `x` [B, d] into mean and deviation."""
        if torch.distributed.is_initialized():
            super().update(x)
            return
        count = len(x)
        mean = x.mean(dim=0, keepdim=True)
        squares = [(chunk - mean).square_().sum(dim=0, keepdim=True) for chunk in x.split(CHUNK)]
        var = torch.stack(squares).sum(dim=0) / count
        # Chan, Golub & LeVeque 1979, as in rsl_rl.
        self.count += count
        rate = count / self.count
        delta = mean - self._mean
        self._mean += rate * delta
        self._var += rate * (var - self._var + delta * (mean - self._mean))
        self._std = torch.sqrt(self._var)


@network("mlp")
def mlp(obs: TensorDict, groups: tuple[str, ...], num_actions: int, **settings: Any) -> torch.nn.Module:
    """rsl_rl's MLP over the concatenated groups; `settings` are its own arguments."""
    return Network(obs, {"actor": list(groups)}, "actor", num_actions, **settings)


@network("cnn")
def cnn(obs: TensorDict, groups: tuple[str, ...], num_actions: int, **settings: Any) -> torch.nn.Module:
    """rsl_rl's CNN for groups of images [N, C, H, W] beside vectors; `settings` are its own arguments."""
    return CNNModel(obs, {"actor": list(groups)}, "actor", num_actions, **settings)


@network("gallant")
def gallant(obs: TensorDict, groups: tuple[str, ...], num_actions: int, **settings: Any) -> torch.nn.Module:
    """Gallant's network over vectors and, as the last group, voxel columns; `settings` are its own arguments."""
    from humoslope.learning.gallant.network import GallantNetwork  # a subclass of what this module defines

    return GallantNetwork(obs, {"actor": list(groups)}, "actor", num_actions, **settings)


class Scale(torch.nn.Module):
    """Multiplies by a constant."""

    def __init__(self, factor: float) -> None:
        super().__init__()
        self.factor = factor

    def forward(self, x: Tensor) -> Tensor:
        """`x` times the factor."""
        return x * self.factor


@network("tanh-mlp")
def tanh_mlp(
    obs: TensorDict, groups: tuple[str, ...], num_actions: int, bound: float, **settings: Any
) -> torch.nn.Module:
    """rsl_rl's MLP with actions within +-`bound`, close to zero at first; `settings` are its own arguments."""
    model = Network(obs, {"actor": list(groups)}, "actor", num_actions, **settings)
    last = model.mlp[-1]
    torch.nn.init.normal_(last.weight, std=0.01)  # as in FastTD3
    torch.nn.init.zeros_(last.bias)
    model.mlp.extend([torch.nn.Tanh(), Scale(bound)])
    return model
