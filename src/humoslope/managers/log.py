"""Averages that gather on the device and are read once per iteration."""

from __future__ import annotations

import torch
from torch import Tensor


class Log:
    """Running means by name; adding never waits for the device."""

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self._sums: dict[str, Tensor] = {}  # name -> [2]: weighted sum, weight

    def add(self, name: str, values: Tensor, mask: Tensor | None = None) -> None:
        """Adds `values` [N] (or a scalar) to the mean called `name`, only where `mask` [N] holds."""
        values = values.to(torch.float32)
        if mask is None:
            entry = torch.stack([values.sum(), torch.full((), float(values.numel()), device=self.device)])
        else:
            weight = mask.to(torch.float32)
            entry = torch.stack([(values * weight).sum(), weight.sum()])
        total = self._sums.get(name)
        self._sums[name] = entry if total is None else total + entry

    def flush(self) -> dict[str, float]:
        """The means since the last flush; a name nothing was added to is left out. Waits for the device, once."""
        if not self._sums:
            return {}
        table = torch.stack(list(self._sums.values())).cpu()
        means = {n: (s / w).item() for n, (s, w) in zip(self._sums, table, strict=True) if w > 0}
        self._sums.clear()
        return means
