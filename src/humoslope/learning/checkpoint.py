"""Checkpoints: one file from which a run continues, or a policy is evaluated, wherever the file lies.

A checkpoint is a dictionary of tensors and plain types, written by `torch.save`:

| key | content |
|---|---|
| `format` | `FORMAT` |
| `task`, `code` | name of the task, commit of the code |
| `iteration`, `total_steps`, `total_time` | training iterations before this one, environment steps, s |
| `config` | the resolved configuration, packed (see `packing`) |
| `policy` | `spec` (which network it is) and `weights` |
| `learner` | what the learner needs to go on: critics, optimisers |
| `env` | curricula and terrain levels |
| `rng` | states of all random generators |
| `parent` | the checkpoint that its run started from, or None |
| `formerly` | SHA-256 of the files it was converted from |

The file ends in the SHA-256 of everything before it, as the comment of the zip archive that `torch.save` writes.
"""

from __future__ import annotations

import hashlib
import io
import math
import re
from collections.abc import Mapping
from pathlib import Path
from types import NoneType
from typing import Any

import torch

from humoslope.errors import UserError
from humoslope.files import read_bytes, write_bytes
from humoslope.learning import format_1
from humoslope.seal import MARK, is_sealed, seal
from humoslope.shipped import found

FORMAT = 2
"""Raised when the layout changes; older layouts are read as long as there is a reader for them."""

CONTENT: dict[str, Any] = {
    **dict.fromkeys(("task", "code"), str),
    **dict.fromkeys(("iteration", "total_steps"), int),
    "total_time": int | float,
    "config": dict | NoneType,
    **dict.fromkeys(("policy", "learner", "env", "rng"), dict),
    "parent": dict | NoneType,
    "formerly": tuple | list,
}
"""Entries of a checkpoint and their types."""


def save(path: Path, state: Mapping[str, Any]) -> None:
    """Writes `state` with format version and checksum in one step.

    Raises:
        UserError: If a weight is not finite, and nothing is written then, or if the file cannot be written.
    """
    write_bytes(path, encoded(path, state))


def encoded(path: Path, state: Mapping[str, Any]) -> memoryview:
    """The content of a checkpoint that is to be written to `path`.

    Raises:
        UserError: If a weight is not finite.
    """
    require_finite(state, f"checkpoint '{path}' is not written")
    return encoded_sealed({"format": FORMAT, **state})


def encoded_sealed(content: Mapping[str, Any]) -> memoryview:
    """Tensors and plain types as a file with a checksum."""
    buffer = io.BytesIO()
    torch.save(dict(content), buffer)
    seal(buffer)
    return buffer.getbuffer()


def load_sealed(path: Path) -> dict[str, Any]:
    """Reads what `encoded_sealed` has made; nothing in it is executed.

    Raises:
        UserError: If it is missing or damaged.
    """
    content = read_bytes("file", path)
    if not is_sealed(content):
        raise UserError(f"'{path}' is damaged.")
    read: dict[str, Any] = torch.load(io.BytesIO(content), weights_only=True)
    return read


def load(path: Path, task: str | None = None, device: torch.device | str = "cpu") -> dict[str, Any]:
    """Reads a checkpoint of this format or an older one, also one that comes with HumoSlope; nothing in it is executed.

    Args:
        task: The task it must belong to; None for any.

    Raises:
        UserError: If the file is missing, damaged, no checkpoint, of an unknown format or another task, or holds a
            weight that is not finite.
    """
    content = read_bytes("checkpoint", found(path))
    if MARK in content[-len(MARK) - 64 :] and not is_sealed(content):
        raise _broken(path)
    try:
        state = torch.load(io.BytesIO(content), map_location=device, weights_only=True)
    except Exception:  # a damaged pickle may raise anything
        raise _broken(path) from None
    if not isinstance(state, dict) or "format" not in state or "task" not in state:
        raise UserError(f"'{path}' is not a HumoSlope checkpoint.")
    if state["format"] == format_1.FORMAT:
        state = format_1.upgrade(path, state)
    elif state["format"] != FORMAT:
        raise UserError(
            f"checkpoint '{path}' has format {state['format']}; this version reads format {FORMAT} and older ones."
        )
    elif not is_sealed(content):
        raise _broken(path)
    _check_content(path, state)
    if task is not None and state["task"] != task:
        raise UserError(f"checkpoint '{path}' belongs to task '{state['task']}', not to '{task}'.")
    require_finite(state, f"checkpoint '{path}' cannot be used")
    return state


def require_finite(state: Mapping[str, Any], refusal: str) -> None:
    """Raises a `UserError` that begins with `refusal` if a tensor of the policy or the learner is not finite."""
    for part in ("policy", "learner"):
        for name, tensor in _tensors(state.get(part), part):
            if tensor.is_floating_point() and not bool(torch.isfinite(tensor).all()):
                raise UserError(f"{refusal}: {name} holds values that are not finite.")


def digest(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with found(path).open("rb") as file:
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


def _tensors(value: Any, name: str) -> list[tuple[str, torch.Tensor]]:
    if isinstance(value, torch.Tensor):
        return [(name, value)]
    if isinstance(value, Mapping):
        return [pair for key, child in value.items() for pair in _tensors(child, f"{name}.{key}")]
    if isinstance(value, list | tuple):
        return [pair for i, child in enumerate(value) for pair in _tensors(child, f"{name}.{i}")]
    return []


def _broken(path: Path) -> UserError:
    return UserError(
        f"checkpoint '{path}' is damaged or truncated, or no checkpoint at all; "
        "a run resumes from the one before it once it is removed."
    )


def _check_content(path: Path, state: Mapping[str, Any]) -> None:
    """Raises UserError unless every entry is there and of its type: a file may be whole and still be made by hand."""
    for name, kind in CONTENT.items():
        if name not in state or not isinstance(state[name], kind):
            raise UserError(f"checkpoint '{path}' has no proper '{name}'; it was not written by this program.")
    for name in ("iteration", "total_steps", "total_time"):
        if not state[name] >= 0 or not math.isfinite(state[name]):
            raise UserError(f"checkpoint '{path}': {name} is {state[name]}; it must be 0 or more.")
    level = state["env"].get("level")
    if not isinstance(level, torch.Tensor) or level.dtype != torch.int64 or level.dim() != 1 or not len(level):
        raise UserError(f"checkpoint '{path}' has no proper 'env.level'; it was not written by this program.")
    if bool((level < 0).any()) or not isinstance(state["env"].get("curriculum"), dict):
        raise UserError(f"checkpoint '{path}' has no proper state of the environment.")
    if set(state["policy"]) != {"spec", "weights"} or not all(isinstance(v, dict) for v in state["policy"].values()):
        raise UserError(f"checkpoint '{path}' has no proper 'policy'; it was not written by this program.")
