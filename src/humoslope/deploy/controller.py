"""An exported policy as it runs on a robot: from measurements to joint targets, as the contract defines them."""

from __future__ import annotations

import hashlib
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from humoslope.deploy.contract import Contract, GaitClock, Network, ObservationGroup
from humoslope.deploy.quantities import CUSTOM, QUANTITIES, Array, Measured
from humoslope.errors import UserError

Input = NDArray[np.float32]


class OnnxPolicy:
    """The network of an export folder, run by onnxruntime.

    Raises:
        UserError: If the file is missing, broken, or not the one that the contract was written for.
    """

    def __init__(self, folder: Path, network: Network) -> None:
        path = folder / network.file
        content = read_hashed(path, network.sha256, "network")
        self._session = load_network(content, str(path))
        self._inputs, self._output = network.inputs, network.output.name
        expected_inputs = [(end.name, list(end.shape)) for end in network.inputs]
        expected_output = [(network.output.name, list(network.output.shape))]
        for what, ends, expected in (
            ("inputs", self._session.get_inputs(), expected_inputs),
            ("outputs", self._session.get_outputs(), expected_output),
        ):
            found = [(end.name, end.shape) for end in ends]
            if found != expected:
                raise UserError(f"'{path}' has the {what} {_listed(found)}; the contract has {_listed(expected)}.")

    def __call__(self, observations: Mapping[str, Input]) -> Array:
        """Returns the action [J] for the observation of each group, without its batch dimension."""
        feed = {end.name: observations[end.group][None] for end in self._inputs}
        (output,) = self._session.run([self._output], feed)
        return np.asarray(output[0], dtype=np.float64)


def read_hashed(path: Path, sha256: str | None, what: str) -> bytes:
    """Reads a file of an export.

    Args:
        path: The file.
        sha256: SHA-256 that it must have, hexadecimal; None for any.
        what: Noun for the file, for messages.

    Raises:
        UserError: If it is missing or has another hash.
    """
    if not path.is_file():
        raise UserError(f"'{path}' does not exist; it is part of the export.")
    content = path.read_bytes()
    if sha256 is not None and hashlib.sha256(content).hexdigest() != sha256:
        raise UserError(f"'{path}' is not the {what} that the contract beside it was written for; export again.")
    return content


def load_network(content: bytes, name: str) -> ort.InferenceSession:
    """Loads an ONNX network from its bytes alone, so that one whose weights lie in another file does not load.

    Raises:
        UserError: If onnxruntime cannot load it.
    """
    options = ort.SessionOptions()
    # The batch has one row and the network is small: more threads would only wait for each other.
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # errors are raised as well
    try:
        return ort.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has a class of its own for every kind of bad file, and no common one
        detail = str(error).strip().splitlines()[0]
        raise UserError(f"'{name}' is no network that onnxruntime can run: {detail}.") from None


def _listed(ends: list[tuple[str, list[int]]]) -> str:
    return ", ".join(f"{name} {shape}" for name, shape in ends) or "none"


class Observer:
    """Composes one observation group: scales each term and keeps its history.

    Raises:
        UserError: If the group has a custom quantity, which is not known here.
    """

    def __init__(self, group: ObservationGroup) -> None:
        for term in group.terms:
            if term.quantity == CUSTOM:
                raise UserError(
                    f"observation '{group.name}.{term.name}' is a custom quantity ({term.meaning or 'not described'}), "
                    "which `humoslope play` cannot compute; run this export from a program that can."
                )
        self._terms = group.terms
        self._history = group.history
        self.reset()

    def reset(self) -> None:
        """Clears the history; the next frame fills it."""
        self._frames: list[deque[Array]] = [deque(maxlen=self._history) for _ in self._terms]

    def __call__(self, measured: Measured) -> Input:
        """Returns the observation [d] with this frame as the newest."""
        parts: list[Array] = []
        for term, frames in zip(self._terms, self._frames, strict=True):
            frame = term.scale * QUANTITIES[term.quantity].read(measured)
            frames.extend([frame] * (1 if frames else self._history))
            parts.extend(frames)
        return np.concatenate(parts).astype(np.float32)


class GaitPhase:
    """Phases of the feet by a contract's gait clock.

    Args:
        clock: The clock.
        control_step_s: Period at which it is asked, s.
    """

    def __init__(self, clock: GaitClock, control_step_s: float) -> None:
        self._clock, self._step = clock, 2.0 * math.pi * control_step_s / clock.period_s
        self._offsets = np.array(clock.offsets_rad)
        self.reset()

    def reset(self) -> None:
        """Begins at rest."""
        self._moved = 0  # control steps of the present motion

    def __call__(self, command: Array) -> Array:
        """Returns the phases [2], rad, of the next control step under a command [3]."""
        if max(math.hypot(command[0], command[1]), abs(command[2])) < self._clock.rest_below:
            self._moved = 0
            return np.full_like(self._offsets, math.pi)
        self._moved += 1
        return self._offsets + self._step * (self._moved - 1)


class Controller:
    """Observations, network and joint targets, with the history and the last action.

    Attributes:
        last_action: [J] last output of the network.
    """

    def __init__(self, contract: Contract, policy: OnnxPolicy) -> None:
        self.observers = {group.name: Observer(group) for group in contract.observations}
        self._policy = policy
        clock, step = contract.gait_clock, contract.timing.control_step_s
        self._phase = None if clock is None else GaitPhase(clock, step)
        self._default = np.array([joint.default_rad for joint in contract.joints])
        self._scale = np.array([joint.action_scale_rad for joint in contract.joints])
        self.reset()

    def reset(self) -> None:
        """Clears the history and the last action."""
        for observe in self.observers.values():
            observe.reset()
        if self._phase is not None:
            self._phase.reset()
        self.last_action = np.zeros(len(self._default))

    def __call__(self, measured: Measured) -> Array:
        """Returns joint targets [J], rad."""
        if self._phase is not None:
            measured = replace(measured, gait_phase=self._phase(measured.command))
        self.last_action = self._policy({group: observe(measured) for group, observe in self.observers.items()})
        return self._default + self._scale * self.last_action
