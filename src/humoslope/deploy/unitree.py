"""The `deploy.yaml` that Unitree RL Lab's C++ deployment reads, from a contract.

Names and rules are those of its `deploy/include/isaaclab`: gains in the order of Unitree's SDK, everything else in the
policy's; observations in the order of the file, each clipped, scaled and kept for `history_length` steps, oldest first.
"""

from __future__ import annotations

import yaml

from humoslope.deploy.contract import Contract, Range
from humoslope.errors import UserError

OBSERVATIONS = {
    "root_angular_velocity": "base_ang_vel",
    "gravity_direction": "projected_gravity",
    "velocity_command": "velocity_commands",
    "joint_position_offset": "joint_pos_rel",
    "joint_velocity": "joint_vel_rel",
    "last_action": "last_action",
}
"""Names of the observations in Unitree's deployment, by quantity."""

COMMAND, INPUT = "base_velocity", "obs"
"""Names of the velocity command and of the network's input in Unitree's deployment."""


def deploy_yaml(contract: Contract) -> str:
    """Returns the text of the file, every number at full precision.

    A robot's joints are in the order of its controller, so that the map from policy to SDK is the identity. The ranges
    of the commands are widened to contain zero: the deployment clamps the joystick to them, and a released stick must
    be a command to stand.

    Raises:
        UserError: If Unitree's deployment cannot feed the network.
    """
    joints, commands = contract.joints, contract.commands
    if len(contract.observations) != 1:
        groups = ", ".join(group.name for group in contract.observations)
        raise UserError(f"Unitree's deployment feeds one input, but the policy reads the groups {groups}.")
    (group,) = contract.observations
    if (name := contract.network.inputs[0].name) != INPUT:
        raise UserError(f"Unitree's deployment feeds an input called '{INPUT}', but the network's is '{name}'.")
    default = [joint.default_rad for joint in joints]
    observations = {}
    for term in group.terms:
        if term.quantity not in OBSERVATIONS:
            raise UserError(f"observation '{term.name}': Unitree's deployment has none for {term.quantity}.")
        observations[OBSERVATIONS[term.quantity]] = {
            "params": {"command_name": COMMAND} if term.quantity == "velocity_command" else {},
            "clip": None,
            "scale": [term.scale] * len(term.components),
            "history_length": group.history,
        }
    content = {
        "joint_ids_map": list(range(len(joints))),
        "step_dt": contract.timing.control_step_s,
        "stiffness": [joint.stiffness_nm_rad for joint in joints],
        "damping": [joint.damping_nms_rad for joint in joints],
        "default_joint_pos": default,
        "commands": {
            COMMAND: {
                "ranges": {
                    "lin_vel_x": _with_zero(commands.forward_m_s),
                    "lin_vel_y": _with_zero(commands.left_m_s),
                    "ang_vel_z": _with_zero(commands.yaw_rate_rad_s),
                    "heading": None,
                }
            }
        },
        "actions": {
            "JointPositionAction": {
                "clip": None,
                "joint_names": [joint.name for joint in joints],
                "scale": [joint.action_scale_rad for joint in joints],
                "offset": list(default),
                "joint_ids": None,
            }
        },
        "observations": observations,
    }
    text: str = yaml.dump(content, Dumper=_Plain, sort_keys=False, default_flow_style=None, width=110)
    return text


class _Plain(yaml.SafeDumper):
    """Writes a list that occurs twice out again, instead of an anchor and a reference to it."""

    def ignore_aliases(self, data: object) -> bool:
        """Overrides `yaml.SafeDumper`."""
        return True


def _with_zero(limits: Range) -> list[float]:
    return [min(limits[0], 0.0), max(limits[1], 0.0)]
