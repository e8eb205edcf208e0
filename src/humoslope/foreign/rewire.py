"""Nodes around a network that translate between a contract's order of numbers and the network's own."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from humoslope.errors import UserError
from humoslope.foreign.policy import ForeignPolicy, ForeignTerm

INPUT, OUTPUT = "obs", "actions"
"""Names of input and output in front of and behind the nodes."""
ACTIONS = ("actions", "action")
"""Names that the output with the actions may have, if there are several."""
Indices = NDArray[np.int64]


def load(content: bytes, name: str) -> Any:
    """Returns a network.

    Raises:
        UserError: If it is none.
    """
    try:
        return onnx.load_from_string(content)
    except Exception as error:  # protobuf has no common class for a bad file
        raise UserError(f"'{name}' is no ONNX network: {str(error).strip().splitlines()[0]}.") from None


def metadata_of(model: Any) -> dict[str, str]:
    """Returns the metadata of a network."""
    return {entry.key: entry.value for entry in model.metadata_props}


def rewired(model: Any, policy: ForeignPolicy, joints: tuple[str, ...], name: str) -> bytes:
    """Returns the network with input and output as a contract describes them.

    The contract has the same terms in the same order, but joints in the order of `joints`, the frames of each term
    together, one history for all, and one scale for all components of a term (see `common_scale`).

    Args:
        model: The network.
        policy: What it reads and writes.
        joints: Joints in the order of the robot.
        name: File for messages.

    Raises:
        UserError: If it has other inputs or outputs than the policy says.
    """
    inputs = [end for end in model.graph.input if end.name not in {one.name for one in model.graph.initializer}]
    if len(inputs) != 1:
        raise UserError(f"'{name}' has the inputs {', '.join(end.name for end in inputs)}; only one can be fed.")
    output = _output(model, name)
    order = [policy.joints.index(joint) for joint in joints]  # of the policy's joints
    indices = source_indices(policy, order)
    if (width := _width(inputs[0])) != len(indices):
        sizes = ", ".join(f"{term.name} {term.history * term.size(len(joints))}" for term in policy.terms)
        raise UserError(f"'{name}' reads {width} numbers, but its observations have {len(indices)}: {sizes}.")
    if (width := _width(output)) != len(joints):
        raise UserError(f"'{name}' gives {width} numbers for {len(joints)} joints.")
    for end in (inputs[0], output):
        end.type.tensor_type.shape.dim[0].dim_value = 1

    network = onnx.compose.add_prefix(model, "policy/")
    del network.metadata_props[:]
    before = _Chain(INPUT, (1, _width_of_contract(policy, len(joints))))
    if not np.array_equal(indices, np.arange(before.width)):
        before.add("Gather", indices, axis=1)
    scale, low, high = _factors(policy)
    if (scale != 1.0).any():
        before.add("Mul", scale)
    if np.isfinite(low).any() or np.isfinite(high).any():
        before.add("Max", low)
        before.add("Min", high)
    after = _Chain("policy_action", (1, len(joints)))
    if np.isfinite(policy.action_bound):
        bound = np.full(len(joints), policy.action_bound, dtype=np.float32)
        after.add("Max", -bound)
        after.add("Min", bound)
    if order != list(range(len(joints))):
        after.add("Gather", np.array(order, dtype=np.int64), axis=1)
    opsets, version = list(model.opset_import), model.ir_version
    first = before.model("observation", len(indices), opsets, version)
    last = after.model(OUTPUT, len(joints), opsets, version)
    joined = onnx.compose.merge_models(first, network, [("observation", f"policy/{inputs[0].name}")])
    # Other outputs, such as the reference of a motion, are not asked for.
    whole = onnx.compose.merge_models(joined, last, [(f"policy/{output.name}", "policy_action")], outputs=[OUTPUT])
    return bytes(whole.SerializeToString())


def source_indices(policy: ForeignPolicy, order: list[int]) -> Indices:
    """Returns for each number of the network's input its place in the contract's.

    Args:
        policy: The policy.
        order: Index among the policy's joints of each joint of the robot.
    """
    count, history = len(order), max(term.history for term in policy.terms)
    place_of_joint = np.argsort(order)  # of each of the policy's joints among the robot's
    blocks, begin = [], 0
    for term in policy.terms:
        size = term.size(count)
        block = begin + np.arange(history * size).reshape(history, size)
        begin += history * size
        blocks.append(block[history - term.history :, place_of_joint if term.is_per_joint else slice(None)])
    if policy.frames_together:
        return np.concatenate(blocks, axis=1).reshape(-1)
    return np.concatenate([block.reshape(-1) for block in blocks])


def common_scale(term: ForeignTerm) -> float:
    """Returns the scale of all components of a term; 1 if they differ, and are scaled inside of the network's file."""
    return term.scale[0] if len(set(term.scale)) == 1 else 1.0


def _factors(policy: ForeignPolicy) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Scale, beyond the contract's, and bounds of each number of the network's input."""
    frames = []
    for term in policy.terms:
        size = term.size(len(policy.joints))
        scale = np.broadcast_to(np.array(term.scale) if len(set(term.scale)) > 1 else 1.0, size)
        low, high = (np.broadcast_to(np.array([bound[i] for bound in term.bounds]), size) for i in (0, 1))
        frames.append(np.stack([scale, low, high]))
    if policy.frames_together:
        whole = np.tile(np.concatenate(frames, axis=1), policy.terms[0].history)
    else:
        whole = np.concatenate(
            [np.tile(frame, term.history) for frame, term in zip(frames, policy.terms, strict=True)], axis=1
        )
    scale, low, high = whole.astype(np.float32)
    return scale, low, high


def _width_of_contract(policy: ForeignPolicy, joints: int) -> int:
    return max(term.history for term in policy.terms) * sum(term.size(joints) for term in policy.terms)


def _output(model: Any, name: str) -> Any:
    ends = list(model.graph.output)
    named = [end for end in ends if end.name in ACTIONS] if len(ends) > 1 else ends
    if len(named) != 1:
        raise UserError(f"'{name}' has the outputs {', '.join(end.name for end in ends)}; none is called '{OUTPUT}'.")
    return named[0]


def _width(end: Any) -> int:
    """Size of a vector [1, d] or [batch, d]; 0 if it is something else."""
    dims = end.type.tensor_type.shape.dim
    return int(dims[1].dim_value) if len(dims) == 2 and dims[0].dim_value in (0, 1) else 0


class _Chain:
    """Nodes one behind the other, from a vector [1, width] on."""

    def __init__(self, start: str, shape: tuple[int, int]) -> None:
        self.width = shape[1]
        self._start, self._end, self._prefix = start, start, start
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def add(self, kind: str, constant: NDArray[Any], **attributes: Any) -> None:
        """Adds a node with the present end and a constant as inputs."""
        step = f"{self._prefix}/{len(self._nodes)}_{kind.lower()}"
        self._constants.append(numpy_helper.from_array(constant, f"{step}_constant"))
        self._nodes.append(helper.make_node(kind, [self._end, f"{step}_constant"], [step], **attributes))
        self._end = step

    def model(self, end: str, width: int, opsets: list[Any], version: int) -> Any:
        """Returns the chain as a network whose output, a vector [1, width], is called `end`."""
        nodes = [*self._nodes, helper.make_node("Identity", [self._end], [end])]
        ends = (
            helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, size])
            for name, size in ((self._start, self.width), (end, width))
        )
        first, last = ends
        graph = helper.make_graph(nodes, self._prefix, [first], [last], self._constants)
        return helper.make_model(graph, opset_imports=opsets, ir_version=version)
