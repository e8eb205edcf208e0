"""Watch for NaN and infinity in what terms and policies return."""

from __future__ import annotations

import torch
from torch import Tensor

NEVER = 2**62
"""First bad step of a column that has always been finite."""


class Watched:
    """Memory of the values of one source, one column per component. Adding never waits for the device."""

    def __init__(self, columns: dict[str, int], num_envs: int, device: torch.device) -> None:
        """Starts with nothing seen.

        Args:
            columns: Number of columns under each name; they stand in this order.
        """
        self._columns = columns
        size = sum(columns.values())
        self._poison = torch.zeros(num_envs, size, device=device)  # [N, C] 0; NaN once a value was not finite
        self._next = torch.zeros(size, dtype=torch.int64, device=device)  # [C] step after the last fine one
        self._zero = torch.zeros((), device=device)
        self._began: int | None = None  # first step that was looked at

    def add(self, values: Tensor, step: int) -> None:
        """Looks at the values [N, ...] of a step, one after the other; they are flattened to [N, C]."""
        if self._began is None:
            self._began = step
        if values.dim() > 2:
            values = values.flatten(1)
        # 0 times a finite number is 0, and NaN otherwise. Everything happens in place: the tensors are then usable
        # inside and outside of inference mode, wherever they were made.
        self._poison.addcmul_(values, self._zero)
        column = self._poison.sum(dim=0)  # [C] 0 or NaN
        self._next.masked_fill_(column == 0.0, step + 1)

    def counts(self) -> Tensor:
        """Number of envs with a bad value and first bad step of each name, [T, 2] int64, on the device."""
        bad = self._poison.isnan()
        rows = []
        for columns, next_step in zip(
            bad.split(list(self._columns.values()), dim=1),
            self._next.split(list(self._columns.values())),
            strict=True,
        ):
            first = torch.where(columns.any(dim=0), next_step, NEVER).amin().clamp(min=self._began or 0)
            rows.append(torch.stack([columns.any(dim=1).sum(), first]))
        return torch.stack(rows)

    def clear(self) -> None:
        """Forgets what was seen."""
        self._poison.zero_()
        self._next.zero_()
        self._began = None

    @property
    def names(self) -> list[str]:
        """Names of the sources' parts."""
        return list(self._columns)


class FiniteWatch:
    """Finds values that are not finite, in any number of sources, and reports them by name.

    Attributes:
        sources: What is watched.
        step: Control steps since the last report; 0 before the first one.
    """

    def __init__(self, num_envs: int, device: torch.device) -> None:
        self._num_envs, self._device = num_envs, device
        self.sources: list[Watched] = []
        self.step = 0

    def watch(self, columns: dict[str, int]) -> Watched:
        """Returns a new source with this number of columns under each name."""
        source = Watched({name: width for name, width in columns.items() if width}, self._num_envs, self._device)
        self.sources.append(source)
        return source

    def report(self) -> list[str]:
        """Returns a sentence per name whose values were not finite since the last report. Waits for the device."""
        sources = [source for source in self.sources if source.names]
        table = torch.cat([source.counts() for source in sources]).tolist() if sources else []
        names = [name for source in sources for name in source.names]
        for source in sources:
            source.clear()
        self.step = 0
        return [
            f"{name} was not finite in {envs} of {self._num_envs} envs (first in step {first} since the last look)"
            for name, (envs, first) in zip(names, table, strict=True)
            if envs > 0
        ]
