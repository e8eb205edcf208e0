"""Random numbers of a trial: they depend on the trial alone, and not on others that run beside it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

_GAMMA = 0x9E3779B97F4A7C15
_MIX_1, _MIX_2 = 0xBF58476D1CE4E5B9, 0x94D049BB133111EB


def trial_keys(seed: int, grade: float, tier: float, count: int, keys: int = 2) -> Tensor:
    """Independent 64-bit keys for each of the first `count` trials of a cell, int64 [count, keys].

    A trial's keys depend on its cell and its index alone, not on which other cells and trials there are; more keys
    begin with fewer.

    Args:
        grade: Grade of the cell, degrees.
        tier: Friction tier of the cell.
    """
    cell = (seed, round(grade * 1000), round(tier * 1000))
    drawn = [np.random.SeedSequence((*cell, i)).generate_state(keys, np.uint64) for i in range(count)]
    return torch.from_numpy(np.array(drawn).view(np.int64))


def uniform(key: Tensor, step: Tensor, columns: int) -> Tensor:
    """Uniform numbers in [0, 1) for every trial at its own step, float32 [N, columns].

    Column j of step s is number s * columns + j of the trial's SplitMix64 sequence (Steele, Lea & Flood 2014), which is
    computed without its predecessors; its upper 24 bits are the fraction.

    Args:
        key: [N] int64 seed of each sequence.
        step: [N] int64, 0 or more.
    """
    index = step[:, None] * columns + torch.arange(1, columns + 1, device=key.device)
    z = key[:, None] + index * _as_int64(_GAMMA)  # wraps around on purpose
    z = (z ^ _shift(z, 30)) * _as_int64(_MIX_1)
    z = (z ^ _shift(z, 27)) * _as_int64(_MIX_2)
    z = z ^ _shift(z, 31)
    return _shift(z, 40).to(torch.float32) * 2.0**-24


def _shift(z: Tensor, bits: int) -> Tensor:
    """Logical shift to the right; torch's own keeps the sign."""
    return (z >> bits) & ((1 << (64 - bits)) - 1)


def _as_int64(word: int) -> int:
    """The unsigned 64-bit word as a signed one with the same bits."""
    return word - (1 << 64) if word >= 1 << 63 else word
