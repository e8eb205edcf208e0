"""Fields of the model and of its data that a simulation gives access to, and limits common to every backend."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from torch import Tensor

from humoslope.errors import UserError, unknown

STATE_FIELDS = ("qpos", "qvel", "ctrl", "xfrc_applied", "time")
"""Fields the caller may write: part of the state, or driving it."""

FASTEST = 1e3
"""Largest velocity of a world that counts as whole, rad/s or m/s. Motors reach some 40 rad/s; a physics that explodes
passes this within a step or two, long before its numbers stop being finite."""


def check_state(field: str) -> None:
    """Raises UserError unless `field` is a state field."""
    if field not in STATE_FIELDS:
        raise unknown("state field", field, STATE_FIELDS)


def check_reading(model: mujoco.MjModel, field: str) -> None:
    """Raises UserError unless `field` is an array of `MjData` that a step computes."""
    if field in STATE_FIELDS:
        raise UserError(f"'{field}' is a state field; get it with state('{field}').")
    known = _array_names(mujoco.MjData(model))
    if field not in known:
        raise unknown("reading", field, known)


def check_model_field(model: mujoco.MjModel, field: str) -> None:
    """Raises UserError unless `field` is a floating-point array of `MjModel`."""
    if field.startswith("_") or not _is_floating(getattr(model, field, None)):
        raise unknown(
            "model field", field, [name for name in _array_names(model) if _is_floating(getattr(model, name))]
        )


def no_access(field: str, backend: str) -> UserError:
    """Error for a field that MuJoCo has but a backend does not."""
    return UserError(f"MuJoCo has '{field}', but the {backend} backend gives no access to it per world.")


def check_reset(model: mujoco.MjModel, num_worlds: int, mask: Tensor, qpos: Tensor, qvel: Tensor) -> None:
    """Raises ValueError unless the arguments of `Simulation.reset` have the shapes it documents."""
    shapes = (tuple(mask.shape), tuple(qpos.shape), tuple(qvel.shape))
    right = ((num_worlds,), (num_worlds, model.nq), (num_worlds, model.nv))
    if shapes != right or mask.dtype != torch.bool:
        raise ValueError(f"reset takes a bool mask, qpos and qvel of shapes {right}, not {mask.dtype} {shapes}")


def replace(target: Tensor, mask: Tensor, value: Tensor) -> None:
    """Writes `value` into `target` [N, ...] where `mask` [N] holds; broadcasts, and converts to the target's dtype."""
    where = mask.view(-1, *(1,) * (target.dim() - 1))
    target.copy_(torch.where(where, value.to(target.dtype), target))


def _is_floating(value: object) -> bool:
    return isinstance(value, np.ndarray) and np.issubdtype(value.dtype, np.floating)


def _array_names(struct: mujoco.MjModel | mujoco.MjData) -> list[str]:
    names = (name for name in dir(struct) if not name.startswith("_"))
    return [name for name in names if isinstance(getattr(struct, name), np.ndarray)]
