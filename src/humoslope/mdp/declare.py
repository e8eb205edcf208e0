"""What an observation function declares of itself: its mirror image, and the quantity that a robot would measure.

A mirror image is a permutation and a sign for each component, for left/right symmetry.
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
    """Declares how an observation function's output is mirrored:
    by `image(env, **params)`, with the term's parameters."""

    def declare(func: F) -> F:
        func.mirror_image = image  # type: ignore[attr-defined]
        return func

    return declare


def polar(env: Env, **params: object) -> Image:
    """A vector such as a velocity: the left component turns round."""
    return torch.arange(3), torch.tensor([1.0, -1.0, 1.0])


def axial(env: Env, **params: object) -> Image:
    """A rotation such as an angular velocity: roll and yaw turn round."""
    return torch.arange(3), torch.tensor([-1.0, 1.0, -1.0])


def planar_velocity(env: Env, **params: object) -> Image:
    """Forward, left, yaw rate."""
    return torch.arange(3), torch.tensor([1.0, -1.0, -1.0])


def joints(env: Env, **params: object) -> Image:
    """One value per joint."""
    return joint_image(env.robot)


def feet(env: Env, **params: object) -> Image:
    """One value per foot."""
    return torch.tensor([1, 0]), torch.ones(2)


def itself(env: Env, **params: object) -> Image:
    """One value that has no side."""
    return torch.zeros(1, dtype=torch.int64), torch.ones(1)


def joint_image(robot: Robot) -> Image:
    """Left joints change place with right ones; roll and yaw joints turn round, by their names.

    Raises:
        UserError: If a left joint has no partner.
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
    """Declares which quantity of `humoslope.deploy.quantities` an observation function returns.

    An actor can be exported only if each of its observations says so.
    """

    def declare(func: F) -> F:
        func.measured_quantity = quantity  # type: ignore[attr-defined]
        return func

    return declare
