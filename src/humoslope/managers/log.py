"""Averages that accumulate on the device and are read once per iteration."""

from __future__ import annotations

import torch
from torch import Tensor

PATIENCE = 32
"""Additions to a name that are summed together: summing costs more than keeping."""


class Log:
    """Running means by name. Adding never waits for the device.

    Tensors that were added are summed later; they must not be written to afterwards.
    """

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self._waiting: dict[tuple[str, bool], list[tuple[Tensor, Tensor | None]]] = {}  # by name and "with a mask"
        self._sums: dict[tuple[str, ...], Tensor] = {}  # names -> [T, 2]: weighted sum, weight

    def add(self, name: str, values: Tensor, mask: Tensor | None = None) -> None:
        """Adds `values` [N] (or a scalar) to the mean called `name`, only where `mask` [N] holds."""
        waiting = self._waiting.setdefault((name, mask is not None), [])
        waiting.append((values, mask))
        if len(waiting) == PATIENCE:
            self._settle(name, mask is not None)

    def add_columns(self, names: tuple[str, ...], values: Tensor, mask: Tensor) -> None:
        """Adds each column of `values` [N, T] to the mean of its name, only where `mask` [N] holds."""
        weight = mask.to(torch.float32)
        sums = weight @ values  # [T]
        entries = torch.stack([sums, weight.sum().expand_as(sums)], dim=1)  # [T, 2]
        self._accumulate(names, entries)

    def _settle(self, name: str, masked: bool) -> None:
        added = self._waiting.pop((name, masked))
        values = torch.stack([values for values, _ in added]).to(torch.float32)
        if masked:
            weight = torch.stack([mask for _, mask in added if mask is not None]).to(torch.float32)
            entry = torch.stack([(values * weight).sum(), weight.sum()])
        else:
            entry = torch.stack([values.sum(), torch.full((), float(values.numel()), device=self.device)])
        self._accumulate((name,), entry[None])

    def _accumulate(self, names: tuple[str, ...], entries: Tensor) -> None:
        total = self._sums.get(names)
        self._sums[names] = entries if total is None else total + entries

    def flush(self) -> dict[str, float]:
        """Returns the means since the last flush, without names that nothing was added to. Waits for the device."""
        for name, masked in list(self._waiting):
            self._settle(name, masked)
        if not self._sums:
            return {}
        names = [name for group in self._sums for name in group]
        table = torch.cat(list(self._sums.values())).cpu()
        self._sums.clear()
        return {name: (s / w).item() for name, (s, w) in zip(names, table, strict=True) if w > 0}
