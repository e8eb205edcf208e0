"""What is particular to the Unitree G1 with 29 motors: their order, its build, and its remote control."""

from __future__ import annotations

from humoslope.deploy.contract import Contract
from humoslope.deploy.quantities import QUANTITIES
from humoslope.errors import UserError

LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw")
MOTORS = (
    *(f"{side}_{joint}_joint" for side in ("left", "right") for joint in LEG),
    *(f"waist_{axis}_joint" for axis in ("yaw", "roll", "pitch")),
    *(f"{side}_{joint}_joint" for side in ("left", "right") for joint in ARM),
)
"""Joints in the order of the motors (unitree_sdk2, G1 low-level example)."""
MODE_MACHINE = 5
"""Code of the build with 29 motors and a free waist; 6 has its waist locked."""
BUTTONS = (
    *("R1", "L1", "start", "select", "R2", "L2", "F1", "F3"),
    *("A", "B", "X", "Y", "up", "right", "down", "left"),
)
"""Buttons of the remote control in the order of their bits."""


def motor_of_joint(contract: Contract) -> tuple[int, ...]:
    """Returns the motor of each joint of the contract.

    Raises:
        UserError: If the policy is for another robot.
    """
    names = [joint.name for joint in contract.joints]
    if sorted(names) != sorted(MOTORS):
        strange = next((name for name in names if name not in MOTORS), None)
        detail = f"it has '{strange}'" if strange else f"it has {len(names)} joints"
        raise UserError(f"the policy is for {contract.robot.name}, not for a G1 with {len(MOTORS)} motors: {detail}.")
    return tuple(MOTORS.index(name) for name in names)


def require_measured(contract: Contract) -> None:
    """Checks, before anything moves, that the robot measures all that the policy sees.

    Raises:
        UserError: If it does not.
    """
    for term in (term for group in contract.observations for term in group.terms):
        if term.quantity in QUANTITIES and not QUANTITIES[term.quantity].measured:
            raise UserError(f"the policy sees '{term.name}' ({term.quantity}), which the robot does not measure.")


def pressed(keys: int) -> frozenset[str]:
    """Returns the names of the buttons in a bit mask of the remote control."""
    return frozenset(name for bit, name in enumerate(BUTTONS) if keys >> bit & 1)


def bits(buttons: frozenset[str]) -> int:
    """Returns the bit mask of buttons; the inverse of `pressed`."""
    return sum(1 << BUTTONS.index(name) for name in buttons)
