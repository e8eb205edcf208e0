"""Random generators: seeding, and states that continue a sequence."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import torch

from humoslope.errors import UserError


def seed_everything(seed: int) -> None:
    """Seeds Python, NumPy and torch.

    Raises:
        UserError: If NumPy cannot take it.
    """
    if not 0 <= seed < 2**32:
        raise UserError(f"seed {seed} must be at least 0 and below 2^32.")
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - libraries draw from the global generator
    torch.manual_seed(seed)


def rng_state(device: torch.device) -> dict[str, Any]:
    """The states of the random generators of Python, NumPy and torch, in types that load without executing anything.

    Args:
        device: The device that the run computes on; of several GPUs only its own generator is kept.
    """
    numpy_state: Any = np.random.get_state(legacy=True)  # noqa: NPY002 - libraries draw from the global generator
    _, keys, position, has_gauss, cached = numpy_state
    version, internal, gauss = random.getstate()
    return {
        "python": [version, list(internal), gauss],
        "numpy": [torch.from_numpy(keys.astype(np.int64)), int(position), int(has_gauss), float(cached)],
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state(device) if device.type == "cuda" else None,
    }


def restore_rng(state: dict[str, Any], device: torch.device) -> None:
    """Continues the random sequences from `rng_state`."""
    version, internal, gauss = state["python"]
    random.setstate((version, tuple(internal), gauss))
    keys, position, has_gauss, cached = state["numpy"]
    numpy_state = ("MT19937", keys.cpu().numpy().astype(np.uint32), position, has_gauss, cached)
    np.random.set_state(numpy_state)  # noqa: NPY002
    torch.set_rng_state(state["torch"].cpu())
    if device.type == "cuda" and isinstance(state["cuda"], torch.Tensor):
        torch.cuda.set_rng_state(state["cuda"].cpu(), device)
