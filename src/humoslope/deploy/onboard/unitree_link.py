"""Unitree's SDK2 topics by the optional package far-unitree-sdk, from the side of a controller and of a robot.

The package brings Unitree's own CycloneDDS 0.10.2. CycloneDDS 11 must not join a robot's network: it crashes 0.10.2.
"""

from __future__ import annotations

import ctypes
import socket
import threading
from collections import deque
from importlib import import_module
from typing import Any

import numpy as np

from humoslope.deploy.contract import Contract
from humoslope.deploy.onboard.messages import Command, Inbox, Reading, Remote
from humoslope.deploy.onboard.pace import LOOPBACK, Pace
from humoslope.deploy.onboard.unitree_g1 import MOTORS, bits, motor_of_joint, pressed
from humoslope.deploy.quantities import Array
from humoslope.errors import UserError

INSTALL = "pip install 'humoslope[robot]'"
PERIOD_S = 0.002
"""Period of the messages in both directions, s."""
REAL_TIME = Pace()
KNOWN_COMMANDS = 16
"""Number of own commands that may still be under way."""


def load_sdk(interface: str, only_loopback: bool = False) -> Any:
    """Returns the package.

    Args:
        interface: Name of the network interface that it will be used with.
        only_loopback: Refuse any other; on a network a simulated robot would answer for a real one.

    Raises:
        UserError: If the package is missing, or there is no such network interface.
    """
    if only_loopback and interface != LOOPBACK:
        raise UserError(f"a simulated robot speaks on the loopback interface '{LOOPBACK}' only, not on '{interface}'.")
    names = [name for _, name in socket.if_nameindex()]
    if interface not in names:
        raise UserError(f"there is no network interface '{interface}'; there are: {', '.join(names)}.")
    try:
        return import_module("unitree_interface")
    except ImportError:
        raise UserError(
            f"Unitree's SDK is not installed; `{INSTALL}` installs it, on Linux with Python up to 3.12."
        ) from None


def open_interface(interface: str, tag: str) -> Any:
    """Returns the package's interface to a G1 on a network interface. It is never destroyed, see `_keep`.

    Args:
        interface: Name of the network interface.
        tag: Participants with another tag are not heard; empty on a real robot.

    Raises:
        UserError: See `load_sdk`; or the package cannot use the interface.
    """
    sdk = load_sdk(interface)
    chosen = f'<NetworkInterface name="{interface}" multicast="true"/>'
    discovery = f"<Discovery><Tag>{tag}</Tag></Discovery>" if tag else ""
    config = (
        f'<CycloneDDS><Domain Id="any"><General><Interfaces>{chosen}</Interfaces></General>{discovery}</Domain>'
        "</CycloneDDS>"
    )
    try:
        return _keep(sdk.UnitreeInterface.create_g1(interface, dds_config=config))
    except RuntimeError as error:
        detail = " ".join(str(error).split())
        raise UserError(f"Unitree's SDK could not use the network interface '{interface}': {detail}.") from None


def _keep(interface: Any) -> Any:
    """Lets the package's interface live as long as the process.

    CycloneDDS 0.10.2 aborts the process if a reader is destroyed in the moment in which a message arrives, and a robot
    sends one every 2 ms. The walk that was about to be saved would be lost.
    """
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(interface))
    return interface


class UnitreeLink:
    """A link to a G1, or to a simulated one.

    The package repeats the last command every 2 ms by itself. A thread looks for new messages as often, because the
    package gives neither a time nor a number with them.

    Args:
        contract: The contract, for the order of joints.
        interface: Name of the network interface.
        tag: See `open_interface`.
        pace: The clock.

    Raises:
        UserError: See `open_interface`; or the policy is for another robot.
    """

    def __init__(self, contract: Contract, interface: str, tag: str = "", pace: Pace = REAL_TIME) -> None:
        self._pace, self._motors = pace, np.array(motor_of_joint(contract))
        self._robot = open_interface(interface, tag)
        self._sdk = import_module("unitree_interface")
        self.inbox = Inbox()
        self._own: deque[tuple[float, ...]] = deque(maxlen=KNOWN_COMMANDS)
        self._count = 0
        self._before: tuple[float, ...] = ()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True, name="listening")
        self._thread.start()

    def read(self, age_s: float = 0.0) -> Reading | None:
        """See `Link`."""
        return self.inbox.read(self._pace.now(), age_s)

    def write(self, command: Command) -> None:
        """See `Link`."""
        message = self._sdk.MotorCommand(len(MOTORS))
        zeros = [0.0] * len(MOTORS)
        message.dq_target, message.tau_ff = zeros, zeros
        message.q_target = self._in_motor_order(command.target)
        message.kp, message.kd = self._in_motor_order(command.stiffness), self._in_motor_order(command.damping)
        self._own.append(_numbers(message))
        self._robot.write_low_command(message)

    def foreign(self) -> bool:
        """See `Link`. Commands without gains and targets cannot be told from no command."""
        heard = _numbers(self._robot.read_incoming_command())
        return any(heard) and heard not in list(self._own)

    def close(self) -> None:
        """See `Link`. The package repeats the last command until the process ends."""
        self._ended.set()
        self._thread.join()

    def _in_motor_order(self, values: Array) -> list[float]:
        ordered = np.zeros(len(MOTORS))
        ordered[self._motors] = values
        return ordered.tolist()

    def _listen(self) -> None:
        while not self._ended.wait(self._pace.real(PERIOD_S)):
            reading = self._look()
            if reading is not None:
                self.inbox.add(self._pace.now(), reading)

    def _look(self) -> Reading | None:
        """Returns the newest message if it is another than the one before."""
        state, controller = self._robot.read_low_state(), self._robot.read_wireless_controller()
        motor, imu = state.motor, state.imu
        now = (*motor.q, *motor.dq, *imu.omega)
        if now == self._before or not any(imu.quat):
            return None
        self._count, self._before = self._count + 1, now
        order = self._motors
        return Reading(
            count=self._count,
            quat_w=np.array(imu.quat, dtype=np.float64),
            ang_vel_b=np.array(imu.omega, dtype=np.float64),
            joint_pos=np.array(motor.q, dtype=np.float64)[order],
            joint_vel=np.array(motor.dq, dtype=np.float64)[order],
            torque=np.array(motor.tau_est, dtype=np.float64)[order],
            temperature=np.array(motor.temperature, dtype=np.float64)[order],
            errors=np.zeros(len(order)),  # the package does not pass them on
            mode_machine=int(state.mode_machine),
            remote=Remote(pressed(int(controller.keys)), controller.ly, -controller.lx, -controller.rx),
        )


class UnitreeRobot:
    """The robot's side of the same topics, for a simulated one.

    Args:
        contract: The contract, for the order of joints.
        interface: Name of the network interface.
        tag: See `open_interface`.

    Raises:
        UserError: If the interface is not the loopback: on a network this would answer for a real robot.
    """

    def __init__(self, contract: Contract, interface: str, tag: str) -> None:
        load_sdk(interface, only_loopback=True)
        self._motors = np.array(motor_of_joint(contract))
        self._robot = open_interface(interface, tag)
        self._sdk = import_module("unitree_interface")
        self._robot.enable_motion_switcher_responder()
        self._before: tuple[float, ...] = ()

    def hear(self) -> Command | None:
        """Returns the newest command if it is another than the one before."""
        message = self._robot.read_incoming_command()
        numbers = _numbers(message)
        if not any(numbers) and not self._before:
            return None
        if numbers == self._before:
            return None
        self._before = numbers
        order = self._motors
        return Command(
            np.array(message.q_target, dtype=np.float64)[order],
            np.array(message.kp, dtype=np.float64)[order],
            np.array(message.kd, dtype=np.float64)[order],
        )

    def say(self, reading: Reading) -> None:
        """Sends a message."""
        state = self._sdk.LowState(len(MOTORS))
        motor, imu = state.motor, state.imu
        motor.q, motor.dq = self._in_motor_order(reading.joint_pos), self._in_motor_order(reading.joint_vel)
        motor.tau_est = self._in_motor_order(reading.torque)
        motor.temperature = [int(value) for value in self._in_motor_order(reading.temperature)]
        imu.quat, imu.omega = reading.quat_w.tolist(), reading.ang_vel_b.tolist()
        state.motor, state.imu, state.mode_machine = motor, imu, reading.mode_machine
        self._robot.publish_low_state(state)

    def press(self, remote: Remote) -> None:
        """Sends the state of the remote control."""
        message = self._sdk.WirelessController()
        message.keys = bits(remote.buttons)
        message.ly, message.lx, message.rx = remote.forward, -remote.left, -remote.turn
        self._robot.publish_wireless_controller(message)

    def _in_motor_order(self, values: Array) -> list[float]:
        ordered = np.zeros(len(MOTORS))
        ordered[self._motors] = values
        return ordered.tolist()


def _numbers(message: Any) -> tuple[float, ...]:
    """The numbers of a command as they are on the wire, in single precision."""
    values = (*message.q_target, *message.kp, *message.kd, *message.dq_target, *message.tau_ff)
    return tuple(np.array(values, dtype=np.float32).tolist())
