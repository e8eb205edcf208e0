"""Random numbers that belong to a trial: they depend on nothing else that is being measured beside it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

_GAMMA = 0x9E3779B97F4A7C15
_MIX_1, _MIX_2 = 0xBF58476D1CE4E5B9, 0x94D049BB133111EB


def trial_keys(seed: int, grade: float, tier: float, count: int) -> Tensor:
    """Two independent 64-bit keys for each of the first `count` trials of a cell, int64 [count, 2].

    A trial's keys depend on its cell and its number alone, not on which other cells and trials there are.

    Args:
        grade: Degrees.
        tier: Of friction.
    """
    cell = (seed, round(grade * 1000), round(tier * 1000))
    keys = [np.random.SeedSequence((*cell, i)).generate_state(2, np.uint64) for i in range(count)]
    return torch.from_numpy(np.array(keys).view(np.int64))


def uniform(key: Tensor, step: Tensor, columns: int) -> Tensor:
    """Uniform numbers in [0, 1) of every trial at its own step, float32 [W, columns].

    Column j of step s is number s * columns + j of the trial's SplitMix64 sequence (Steele, Lea & Flood 2014), which is
    computed without its predecessors; its upper 24 bits are the fraction.

    Args:
        key: [W] int64, the seed of each sequence.
        step: [W] int64, 0 or more.
    """
    index = step[:, None] * columns + torch.arange(1, columns + 1, device=key.device)
    z = key[:, None] + index * _signed(_GAMMA)  # wraps, as it should
    z = (z ^ _shift(z, 30)) * _signed(_MIX_1)
    z = (z ^ _shift(z, 27)) * _signed(_MIX_2)
    z = z ^ _shift(z, 31)
    return _shift(z, 40).to(torch.float32) * 2.0**-24


def _shift(z: Tensor, bits: int) -> Tensor:
    """Logical shift to the right; torch's own keeps the sign."""
    return (z >> bits) & ((1 << (64 - bits)) - 1)


def _signed(word: int) -> int:
    """The 64-bit word as torch holds it."""
    return word - (1 << 64) if word >= 1 << 63 else word
