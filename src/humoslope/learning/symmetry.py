"""Left/right symmetry: the mirror image of every sample is a sample, too."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from torch import Tensor

from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.managers import ObservationGroupCfg
from humoslope.mdp.declare import Image, joint_image


class Mirror:
    """Mirrors observations and actions of an environment; doing it twice changes nothing."""

    def __init__(self, env: ManagerBasedRlEnv) -> None:
        self.groups = {
            name: _to(group_image(env, name, group), env.device) for name, group in env.cfg.observations.items()
        }
        for name, value in env.get_observations().items():
            if value.dim() != 2:
                raise UserError(
                    f"observation group '{name}' is no vector, so that its mirror image is unknown; set agent.symmetry "
                    "to False."
                )
        self.actions = _to(joint_image(env.robot), env.device)

    def observation(self, obs: TensorDict) -> TensorDict:
        """The observations [B, d] in the mirror."""
        return TensorDict(
            {name: apply(image, obs[name]) for name, image in self.groups.items()},
            batch_size=obs.batch_size,
            device=obs.device,
        )

    def action(self, action: Tensor) -> Tensor:
        """The actions [B, J] in the mirror."""
        return apply(self.actions, action)

    def augment(
        self, env: object = None, obs: TensorDict | None = None, actions: Tensor | None = None
    ) -> tuple[TensorDict | None, Tensor | None]:
        """rsl_rl's augmentation: the originals first, then their mirror images."""
        both = None
        if obs is not None:
            groups = {name: with_image(image, obs[name]) for name, image in self.groups.items()}
            both = TensorDict(groups, batch_size=[2 * obs.batch_size[0]], device=obs.device)
        return both, None if actions is None else with_image(self.actions, actions)


def apply(image: Image, x: Tensor) -> Tensor:
    """Mirrors `x` [..., d]."""
    index, sign = image
    return x.index_select(-1, index) * sign


def with_image(image: Image, x: Tensor) -> Tensor:
    """`x` [B, d] and its mirror image below it, [2B, d]; written once, since the learner does this for every batch."""
    index, sign = image
    both = x.new_empty(2 * len(x), x.shape[1])
    both[: len(x)] = x
    torch.index_select(x, 1, index, out=both[len(x) :])
    both[len(x) :] *= sign
    return both


def group_image(env: ManagerBasedRlEnv, name: str, group: ObservationGroupCfg) -> Image:
    """Mirror image of a whole observation group, history included.

    Raises:
        UserError: If a term does not say how it looks in the mirror.
    """
    indices, signs, start = [], [], 0
    for term_name, term in group.terms.items():
        image = getattr(term.func, "mirror_image", None)
        if image is None:
            raise UserError(
                f"observation '{name}.{term_name}' does not say how it is mirrored; "
                "decorate it with @mirrored_as or set agent.symmetry to False."
            )
        index, sign = image(env, **term.params)
        for _ in range(group.history):
            indices.append(index + start)
            signs.append(sign)
            start += len(index)
    return torch.cat(indices), torch.cat(signs)


def _to(image: Image, device: torch.device) -> Image:
    return image[0].to(device), image[1].to(device)
