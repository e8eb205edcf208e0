"""Averages that gather on the device and are read once per iteration."""

from __future__ import annotations

import torch
from torch import Tensor


class Log:
    """Running means by name; adding never waits for the device."""

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self._sums: dict[tuple[str, ...], Tensor] = {}  # names -> [T, 2]: weighted sum, weight

    def add(self, name: str, values: Tensor, mask: Tensor | None = None) -> None:
        """Adds `values` [N] (or a scalar) to the mean called `name`, only where `mask` [N] holds."""
        values = values.to(torch.float32)
        if mask is None:
            entry = torch.stack([values.sum(), torch.full((), float(values.numel()), device=self.device)])
        else:
            weight = mask.to(torch.float32)
            entry = torch.stack([(values * weight).sum(), weight.sum()])
        self._gather((name,), entry[None])

    def add_columns(self, names: tuple[str, ...], values: Tensor, mask: Tensor) -> None:
        """Adds each column of `values` [N, T] to the mean of its name, only where `mask` [N] holds."""
        weight = mask.to(torch.float32)
        sums = weight @ values  # [T]
        entries = torch.stack([sums, weight.sum().expand_as(sums)], dim=1)  # [T, 2]
        self._gather(names, entries)

    def _gather(self, names: tuple[str, ...], entries: Tensor) -> None:
        total = self._sums.get(names)
        self._sums[names] = entries if total is None else total + entries

    def flush(self) -> dict[str, float]:
        """The means since the last flush; a name nothing was added to is left out. Waits for the device, once."""
        if not self._sums:
            return {}
        names = [name for group in self._sums for name in group]
        table = torch.cat(list(self._sums.values())).cpu()
        self._sums.clear()
        return {name: (s / w).item() for name, (s, w) in zip(names, table, strict=True) if w > 0}
