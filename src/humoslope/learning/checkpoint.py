"""Checkpoints: one file from which a run continues, or a policy is evaluated."""

from __future__ import annotations

import hashlib
import pickle
import random
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

from humoslope.errors import UserError
from humoslope.files import write_atomically

FORMAT = 1
"""Raised when a checkpoint of an older format can no longer be read."""


def save(path: Path, state: dict[str, Any]) -> None:
    """Writes `state` with the format version and the states of all random generators, in one step."""
    whole = state | {"format": FORMAT, "rng": rng_state()}
    write_atomically(path, lambda temporary: torch.save(whole, temporary))


def load(path: Path, task: str | None = None, device: torch.device | str = "cpu") -> dict[str, Any]:
    """Reads a checkpoint; nothing in it is executed.

    Args:
        task: The task it must belong to; None for any.

    Raises:
        UserError: If the file is missing, broken, no checkpoint, of another format or of another task.
    """
    if not path.is_file():
        raise UserError(f"checkpoint '{path}' does not exist.")
    try:
        state = torch.load(path, map_location=device, weights_only=True)
    except (RuntimeError, EOFError, OSError, ValueError, KeyError, pickle.UnpicklingError, zipfile.BadZipFile):
        raise UserError(
            f"checkpoint '{path}' is broken or truncated, or no checkpoint at all; "
            "a run resumes from the one before it once it is removed."
        ) from None
    if not isinstance(state, dict) or "format" not in state or "actor_state_dict" not in state:
        raise UserError(f"'{path}' is not a HumoSlope checkpoint.")
    if state["format"] != FORMAT:
        raise UserError(f"checkpoint '{path}' has format {state['format']}; this version reads format {FORMAT}.")
    if task is not None and state["task"] != task:
        raise UserError(f"checkpoint '{path}' belongs to task '{state['task']}', not to '{task}'.")
    return state


def digest(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def latest(run_dir: Path) -> Path:
    """The newest checkpoint of a run folder.

    Raises:
        UserError: If the folder does not exist or holds none.
    """
    if not run_dir.is_dir():
        raise UserError(f"run folder '{run_dir}' does not exist.")
    found = {int(m[1]): p for p in run_dir.glob("model_*.pt") if (m := re.fullmatch(r"model_(\d+)\.pt", p.name))}
    if not found:
        raise UserError(f"run folder '{run_dir}' holds no checkpoint (model_*.pt).")
    return found[max(found)]


def rng_state() -> dict[str, Any]:
    """The states of Python's, NumPy's and torch's random generators, in types that load without executing anything."""
    numpy_state: Any = np.random.get_state(legacy=True)  # noqa: NPY002 - libraries draw from the global generator
    _, keys, position, has_gauss, cached = numpy_state
    version, internal, gauss = random.getstate()
    return {
        "python": [version, list(internal), gauss],
        "numpy": [torch.from_numpy(keys.astype(np.int64)), int(position), int(has_gauss), float(cached)],
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_available() else [],
    }


def restore_rng(state: dict[str, Any]) -> None:
    """Continues the random sequences from `rng_state`."""
    version, internal, gauss = state["python"]
    random.setstate((version, tuple(internal), gauss))
    keys, position, has_gauss, cached = state["numpy"]
    numpy_state = ("MT19937", keys.cpu().numpy().astype(np.uint32), position, has_gauss, cached)
    np.random.set_state(numpy_state)  # noqa: NPY002
    torch.set_rng_state(state["torch"].cpu())
    if torch.cuda.is_available() and len(state["cuda"]) == torch.cuda.device_count():
        torch.cuda.set_rng_state_all([s.cpu() for s in state["cuda"]])
