"""Declarations of observation functions: their mirror image, and the quantity that a robot would measure.

A mirror image is a permutation and a sign for each component, for left/right symmetry augmentation. The augmentation is
ours; the paper does not mention it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import torch
from torch import Tensor

from humoslope.errors import UserError
from humoslope.scene.robot import Robot

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

Image = tuple[Tensor, Tensor]
"""Source index [d] and sign [d]: the mirrored value is `x[..., index] * sign`."""

F = TypeVar("F", bound=Callable[..., Any])


def mirrored_as(image: Callable[..., Image]) -> Callable[[F], F]:
    """Declares the mirror image of an observation function, `image(env, **params)` with the term's parameters."""

    def declare(func: F) -> F:
        func.mirror_image = image  # type: ignore[attr-defined]
        return func

    return declare


def polar(env: Env, **params: object) -> Image:
    """Image of a vector such as a velocity: the left component changes sign."""
    return torch.arange(3), torch.tensor([1.0, -1.0, 1.0])


def axial(env: Env, **params: object) -> Image:
    """Image of a rotation such as an angular velocity: roll and yaw change sign."""
    return torch.arange(3), torch.tensor([-1.0, 1.0, -1.0])


def planar_velocity(env: Env, **params: object) -> Image:
    """Image of a planar velocity (forward, left, yaw rate)."""
    return torch.arange(3), torch.tensor([1.0, -1.0, -1.0])


def joints(env: Env, **params: object) -> Image:
    """Image of one value per joint."""
    return joint_image(env.robot)


def feet(env: Env, **params: object) -> Image:
    """Image of one value per foot."""
    return torch.tensor([1, 0]), torch.ones(2)


def itself(env: Env, **params: object) -> Image:
    """Image of a single value without a side."""
    return torch.zeros(1, dtype=torch.int64), torch.ones(1)


def joint_image(robot: Robot) -> Image:
    """Image of one value per joint: left and right joints change places, and roll and yaw joints change sign.

    Sides and axes are read off the joints' names ("left", "right", "_roll_", "_yaw_").

    Raises:
        UserError: If a left or right joint has no partner.
    """
    index, sign = [], []
    for name in robot.joint_names:
        partner = name.replace("left", "\0").replace("right", "left").replace("\0", "right")
        if partner not in robot.joint_names:
            raise UserError(f"{robot.name}: joint '{name}' has no mirror image '{partner}'.")
        index.append(robot.joint_names.index(partner))
        sign.append(-1.0 if "_roll_" in name or "_yaw_" in name else 1.0)
    return torch.tensor(index), torch.tensor(sign)


def measured_as(quantity: str) -> Callable[[F], F]:
    """Declares the quantity of `humoslope.deploy.quantities` that an observation function returns.

    An actor can be exported only if all its observations declare one.
    """

    def declare(func: F) -> F:
        func.measured_quantity = quantity  # type: ignore[attr-defined]
        return func

    return declare


def reads_bodies(func: F) -> F:
    """Declares that a function or class of a term reads `env.bodies` (see `humoslope.scene.bodies`)."""
    func.reads_bodies = True  # type: ignore[attr-defined]
    return func
