"""Networks with the metadata of mjlab's exporter, which our own exports have too.

mjlab writes three decimals, so that small action scales are off by up to 0.7 %. Its metadata say nothing of the control
step, the commands, and bounds on actions; mjlab's own velocity tasks have 50 Hz and no bounds.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from humoslope.errors import UserError
from humoslope.foreign.policy import ForeignPolicy, ForeignTerm, numbers, quantity_of, repeated, scaled

KEY = "joint_names"
"""Key by which such a file is recognised."""
OBSERVATIONS = {
    "base_lin_vel": "root_linear_velocity",
    "base_ang_vel": "root_angular_velocity",
    "projected_gravity": "gravity_direction",
    "command": "velocity_command",
    "joint_pos": "joint_position_offset",
    "joint_vel": "joint_velocity",
    "actions": "last_action",
    # Our own names.
    "velocity_command": "velocity_command",
    "joint_pos_rel": "joint_position_offset",
    "last_action": "last_action",
}
"""Quantities by the names of the terms in the tasks of mjlab, and in ours."""
SCALE, CLIP = "observation_terms_scale", "observation_terms_clip"
HISTORY, FLAT = "observation_terms_history_length", "observation_terms_flatten_history_dim"
"""Keys that files of older versions lack."""


def read(metadata: Mapping[str, str], path: Path) -> ForeignPolicy:
    """Returns the policy that metadata describe.

    Args:
        metadata: Texts by their keys; lists are separated by commas, and lists in them by semicolons.
        path: The file, for messages.

    Raises:
        UserError: If something is missing, or cannot be said in a contract.
    """

    def texts(key: str) -> list[str]:
        if key not in metadata:
            raise UserError(f"'{path}' has metadata of mjlab, but they lack '{key}'.")
        return metadata[key].split(",")

    def values(key: str) -> tuple[float, ...]:
        return numbers(texts(key), key, path)

    joints, names = tuple(texts(KEY)), texts("observation_names")

    def of_terms(key: str, default: str) -> list[str]:
        given = texts(key) if key in metadata else [default] * len(names)
        if len(given) != len(names):
            raise UserError(f"'{path}': its {key} has {len(given)} entries for {len(names)} observations.")
        return given

    history, flat = of_terms(HISTORY, "1"), of_terms(FLAT, "1")
    scale, clip = of_terms(SCALE, "1"), of_terms(CLIP, "-inf;inf")
    terms = []
    for i, name in enumerate(names):
        frames = int(numbers([history[i]], HISTORY, path)[0])
        if frames > 1 and flat[i] not in ("True", "true") and not float(*numbers([flat[i]], FLAT, path)):
            raise UserError(f"'{path}': the history of its observation '{name}' is not flat.")
        terms.append(
            _term(
                ForeignTerm(name, quantity_of(name, OBSERVATIONS, path), history=max(1, frames)),
                numbers(scale[i].split(";"), SCALE, path),
                numbers(clip[i].split(";"), CLIP, path, finite=False),
                path,
            )
        )
    return ForeignPolicy(
        framework="mjlab",
        joints=joints,
        stiffness=values("joint_stiffness"),
        damping=values("joint_damping"),
        default=values("default_joint_pos"),
        action_scale=repeated(values("action_scale"), len(joints)),
        terms=tuple(terms),
    )


def _term(plain: ForeignTerm, scale: tuple[float, ...], clip: tuple[float, ...], path: Path) -> ForeignTerm:
    """The term with its scale and its bounds, which mjlab and Isaac Lab apply before the scale."""
    if len(clip) != 2:
        raise UserError(f"'{path}': observation '{plain.name}' has {len(clip)} bounds instead of two.")
    return scaled(plain, scale, (clip[0], clip[1]))
