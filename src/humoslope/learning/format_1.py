"""Reader of the first checkpoint format, which held neither its configuration nor a description of its network."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from torch import Tensor

from humoslope.errors import UserError

FORMAT = 1


def upgrade(path: Path, state: dict[str, Any]) -> dict[str, Any]:
    """The same checkpoint in today's layout, with a `config` of None.

    Every agent of that format had an ELU network with a Gaussian on top; its widths are read off the weights.

    Raises:
        UserError: If the file holds another kind of network, or is incomplete.
    """
    try:
        weights, env = state["actor_state_dict"], state["env"]
        layers = _linear_layers(path, weights)
        return {
            "format": FORMAT,
            "task": state["task"],
            "code": "unknown",
            "iteration": state["iter"],
            "total_steps": state["total_steps"],
            "total_time": state["total_time"],
            "config": None,
            "policy": {
                "spec": {
                    "network": "mlp",
                    "groups": ("actor",),
                    "shapes": ((layers[0].shape[1],),),
                    "num_actions": layers[-1].shape[0],
                    "settings": {
                        "hidden_dims": [layer.shape[0] for layer in layers[:-1]],
                        "activation": "elu",
                        "obs_normalization": any(name.startswith("obs_normalizer.") for name in weights),
                        "distribution_cfg": {"class_name": "GaussianDistribution"},
                    },
                },
                "weights": weights,
            },
            "learner": {name: state[name] for name in ("critic_state_dict", "optimizer_state_dict")},
            "env": env,
            "rng": _rng(state["rng"]),
            "parent": _parent(state.get("ancestor")),
            "formerly": (),
        }
    except KeyError as missing:
        raise UserError(f"checkpoint '{path}' lacks {missing}; another version of the code wrote it.") from None


def _linear_layers(path: Path, weights: dict[str, Tensor]) -> list[Tensor]:
    """The weights [out, in] of the network's linear layers, from first to last."""
    numbers = sorted(
        int(name.split(".")[1]) for name in weights if name.startswith("mlp.") and name.endswith(".weight")
    )
    if len(numbers) < 2:
        raise UserError(f"checkpoint '{path}' holds another kind of policy: it has no hidden layer.")
    return [weights[f"mlp.{number}.weight"] for number in numbers]


def _rng(state: dict[str, Any]) -> dict[str, Any]:
    """One state for each GPU was kept then; the run's own is the first."""
    return state | {"cuda": state["cuda"][0] if state["cuda"] else None}


def _parent(ancestor: dict[str, Any] | None) -> dict[str, Any] | None:
    if ancestor is None:
        return None
    return {
        "path": ancestor["path"],
        "sha256": ancestor["sha256"],
        "task": ancestor["task"],
        "iteration": ancestor["iter"],
        "total_steps": ancestor["total_steps"],
        "curriculum": ancestor["curriculum"],
        "parent": _parent(ancestor.get("ancestor")),
        "formerly": (),
    }
