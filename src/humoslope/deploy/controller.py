"""The policy as it runs on a robot: from what is measured to joint targets, by the contract."""

from __future__ import annotations

import hashlib
from collections import deque
from pathlib import Path

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from humoslope.deploy.contract import Contract, Network, Observation
from humoslope.deploy.quantities import QUANTITIES, Array, Measured
from humoslope.errors import UserError


class Policy:
    """The network of an export folder, in onnxruntime.

    Raises:
        UserError: If the file is missing, broken, or not the one that the contract was written for.
    """

    def __init__(self, folder: Path, network: Network) -> None:
        path = folder / network.file
        if not path.is_file():
            raise UserError(f"'{path}' does not exist; it belongs to the export folder '{folder}'.")
        content = path.read_bytes()
        if hashlib.sha256(content).hexdigest() != network.sha256:
            raise UserError(f"'{path}' is not the network that the contract beside it was written for; export again.")
        self._session, self._input = load_network(content, str(path)), network.input
        for what, ends, name, size in (
            ("input", self._session.get_inputs(), network.input, network.inputs),
            ("output", self._session.get_outputs(), network.output, network.outputs),
        ):
            found = ", ".join(f"{end.name} {end.shape}" for end in ends)
            if [(end.name, end.shape) for end in ends] != [(name, [1, size])]:
                raise UserError(f"'{path}' has the {what}s {found}; by the contract it has {name} [1, {size}] alone.")

    def __call__(self, observation: NDArray[np.float32]) -> Array:
        """Action [J] for an observation [inputs]."""
        (output,) = self._session.run(None, {self._input: observation[None]})
        return np.asarray(output[0], dtype=np.float64)


def load_network(content: bytes, name: str) -> ort.InferenceSession:
    """An ONNX network from its bytes alone, so that one whose weights lie in another file does not load.

    Raises:
        UserError: If it is none.
    """
    options = ort.SessionOptions()
    # One row through a small network: more threads would only wait for each other.
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # what goes wrong is raised as well
    try:
        return ort.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has a class of its own for every kind of bad file, and no common one
        detail = str(error).strip().splitlines()[0]
        raise UserError(f"'{name}' is no network that onnxruntime can run: {detail}.") from None


class Observer:
    """Puts the network's input together: scales each term and keeps its history."""

    def __init__(self, observation: Observation) -> None:
        self._terms = observation.terms
        self._history = observation.history
        self.reset()

    def reset(self) -> None:
        """Forgets what was seen; the next frame fills the history."""
        self._frames: list[deque[Array]] = [deque(maxlen=self._history) for _ in self._terms]

    def __call__(self, measured: Measured) -> NDArray[np.float32]:
        """The network's input with this frame as the newest, [inputs]."""
        parts: list[Array] = []
        for term, frames in zip(self._terms, self._frames, strict=True):
            frame = term.scale * QUANTITIES[term.quantity].read(measured)
            frames.extend([frame] * (1 if frames else self._history))
            parts.extend(frames)
        return np.concatenate(parts).astype(np.float32)


class Controller:
    """Observations, network and targets; remembers history and last action.

    Attributes:
        last_action: [J].
    """

    def __init__(self, contract: Contract, policy: Policy) -> None:
        self._observe, self._policy = Observer(contract.observation), policy
        self._default = np.array([joint.default_rad for joint in contract.joints])
        self._scale = np.array([joint.action_scale_rad for joint in contract.joints])
        self.reset()

    def reset(self) -> None:
        """Starts as if nothing had been seen or done."""
        self._observe.reset()
        self.last_action = np.zeros(len(self._default))

    def __call__(self, measured: Measured) -> Array:
        """Joint targets [J], rad."""
        self.last_action = self._policy(self._observe(measured))
        return self._default + self._scale * self.last_action
