"""Observations are put together as the contract says, and the network is the one it was written for."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humoslope.deploy.contract import Contract, Network, NetworkInput, NetworkOutput, ObservationGroup, Term
from humoslope.deploy.controller import Controller, Observer, OnnxPolicy
from humoslope.deploy.quantities import Measured
from humoslope.errors import UserError
from humoslope.slope import quaternion


def term(quantity: str, size: int, scale: float) -> Term:
    return Term(quantity, quantity, "", "", ("1",), tuple("abc"[:size]), (size,), scale, 0.0)


def group(history: int, *terms: Term, name: str = "actor") -> ObservationGroup:
    return ObservationGroup(
        name,
        history,
        "terms in this order; of each term all frames, oldest first",
        "all frames equal the first one",
        terms or (term("velocity_command", 3, 1.0), term("joint_velocity", 3, 0.5)),
    )


def at(measured: Measured, step: int) -> Measured:
    """A measurement whose every number depends on its step."""
    return replace(measured, command=np.array([step, step, step]) + 0.25, joint_vel=np.array([2, 4, 6]) * step)


def test_a_term_keeps_its_frames_together_oldest_first(measured: Measured) -> None:
    observe = Observer(group(history=3))
    for step in range(1, 6):
        seen = observe(at(measured, step))
    assert seen.dtype == np.float32
    np.testing.assert_array_equal(seen[:9].reshape(3, 3), np.array([[3.25], [4.25], [5.25]]) * np.ones(3))
    np.testing.assert_array_equal(seen[9:].reshape(3, 3), np.array([[3], [4], [5]]) * np.array([1.0, 2.0, 3.0]))


def test_the_first_frame_fills_the_history_and_again_after_a_reset(measured: Measured) -> None:
    observe = Observer(group(history=3))
    np.testing.assert_array_equal(observe(at(measured, 1))[:9], np.full(9, 1.25))
    observe(at(measured, 2))
    observe.reset()
    np.testing.assert_array_equal(observe(at(measured, 7))[:9], np.full(9, 7.25))


unit = st.floats(-1.0, 1.0, allow_nan=False)


@given(st.tuples(unit, unit, unit, unit).filter(lambda q: math.hypot(*q) > 0.1))
def test_up_in_the_root_frame_is_that_of_the_training_signals(q: tuple[float, ...]) -> None:
    unit_q = np.array(q) / np.linalg.norm(q)
    seen = replace(MEASURED, root_quat_w=unit_q).up_b
    expected = quaternion.matrix(torch.tensor(unit_q))[2].numpy()
    np.testing.assert_allclose(seen, expected, atol=1e-12)


MEASURED = Measured(np.array([1.0, 0.0, 0.0, 0.0]), *(np.zeros(3) for _ in range(5)))


def test_a_network_other_than_the_contracts_is_refused(exported: Path, contract: Contract, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"policy.onnx' does not exist; it is part of the export"):
        OnnxPolicy(tmp_path, contract.network)
    with pytest.raises(UserError, match="is not the network that the contract beside it was written for"):
        OnnxPolicy(exported, replace(contract.network, sha256="0" * 64))
    with pytest.raises(UserError, match=r"has the inputs obs \[1, 480\]; the contract has obs \[1, 96\]"):
        OnnxPolicy(exported, replace(contract.network, inputs=(NetworkInput("obs", "actor", (1, 96)),)))
    with pytest.raises(UserError, match=r"has the outputs actions \[1, 29\]; the contract has torques"):
        OnnxPolicy(exported, replace(contract.network, output=NetworkOutput("torques", (1, 29))))


@pytest.mark.parametrize("content", [b"", b"no network", bytes(1000)])
def test_a_file_that_is_no_network_is_refused(spoil: Callable[..., Path], contract: Contract, content: bytes) -> None:
    folder = spoil(network=content)
    network = replace(contract.network, sha256=hashlib.sha256(content).hexdigest())
    with pytest.raises(UserError, match="is no network that onnxruntime can run: ") as error:
        OnnxPolicy(folder, network)
    assert "\n" not in str(error.value)


# The controller against the same rules written down once more in NumPy, over the whole sequence at once.

READ: dict[str, Callable[[Measured], np.ndarray]] = {
    "root_angular_velocity": lambda m: m.root_ang_vel_b,
    "gravity_direction": lambda m: Rotation.from_quat(m.root_quat_w, scalar_first=True).inv().apply([0.0, 0.0, -1.0]),
    "velocity_command": lambda m: m.command,
    "joint_position_offset": lambda m: m.joint_pos_rel,
    "joint_velocity": lambda m: m.joint_vel,
    "last_action": lambda m: m.last_action,
}
numbers = st.floats(-10.0, 10.0, allow_nan=False)


@given(
    histories=st.lists(st.integers(1, 4), min_size=1, max_size=3),
    scales=st.lists(numbers, min_size=6, max_size=6),
    steps=st.integers(1, 7),
    seed=st.integers(0, 2**31),
)
def test_targets_follow_from_the_whole_sequence_of_measurements(
    contract: Contract, histories: list[int], scales: list[float], steps: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    count = len(contract.joints)
    groups = []
    for i, history in enumerate(histories):
        chosen = rng.permutation(list(READ))[: rng.integers(1, 7)]
        terms = [term(str(q), 3, scales[k]) for k, q in enumerate(chosen)]
        groups.append(group(history, *terms, name=f"group {i}"))
    fed: list[Mapping[str, np.ndarray]] = []

    def policy(inputs: Mapping[str, np.ndarray]) -> np.ndarray:
        fed.append(inputs)
        return np.sin(np.arange(count) + sum(float(value.sum()) for value in inputs.values()))

    controller = Controller(replace(contract, observations=tuple(groups)), policy)  # type: ignore[arg-type]
    instants = []
    for _ in range(steps):
        quat = rng.normal(size=4)
        instants.append(
            Measured(
                quat / np.linalg.norm(quat),
                rng.normal(size=3),
                rng.normal(size=count),
                rng.normal(size=count),
                rng.normal(size=3),
                controller.last_action,
            )
        )
        targets = controller(instants[-1])
        action = np.sin(np.arange(count) + sum(float(value.sum()) for value in fed[-1].values()))
        expected = [j.default_rad + j.action_scale_rad * a for j, a in zip(contract.joints, action, strict=True)]
        np.testing.assert_allclose(targets, expected, rtol=1e-12)
        np.testing.assert_array_equal(controller.last_action, action)
    padded = [instants[0]] * 10 + instants
    for one in groups:
        parts = [t.scale * READ[t.quantity](m) for t in one.terms for m in padded[-one.history :]]
        np.testing.assert_allclose(fed[-1][one.name], np.concatenate(parts), rtol=1e-5, atol=1e-6)
        assert fed[-1][one.name].dtype == np.float32
    controller.reset()
    np.testing.assert_array_equal(controller.last_action, np.zeros(count))


def two_inputs() -> bytes:
    """A network with a vector [1, 3] and a map [1, 1, 2, 2]: vector plus the sum of the map."""
    value = onnx.helper.make_tensor_value_info
    nodes = [
        onnx.helper.make_node("ReduceSum", ["map"], ["total"], keepdims=0),
        onnx.helper.make_node("Add", ["vector", "total"], ["actions"]),
    ]
    kinds = {"vector": [1, 3], "map": [1, 1, 2, 2]}
    ends = [value(name, onnx.TensorProto.FLOAT, shape) for name, shape in kinds.items()]
    graph = onnx.helper.make_graph(nodes, "toy", ends, [value("actions", onnx.TensorProto.FLOAT, [1, 3])])
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)], ir_version=10)
    return bytes(model.SerializeToString())


def test_a_network_of_several_inputs_is_fed_by_group(tmp_path: Path) -> None:
    (tmp_path / "policy.onnx").write_bytes(two_inputs())
    ends = (NetworkInput("vector", "actor", (1, 3)), NetworkInput("map", "terrain", (1, 1, 2, 2)))
    digest = hashlib.sha256(two_inputs()).hexdigest()
    network = Network("policy.onnx", digest, ends, NetworkOutput("actions", (1, 3)))
    policy = OnnxPolicy(tmp_path, network)
    terrain = np.array([[[1.0, 2.0], [3.0, 4.0]]], np.float32)
    action = policy({"terrain": terrain, "actor": np.array([0.5, 0.0, -0.5], np.float32)})
    np.testing.assert_allclose(action, [10.5, 10.0, 9.5])
    with pytest.raises(UserError, match=r"has the inputs vector \[1, 3\], map .*; the contract has vector \[1, 3\]\."):
        OnnxPolicy(tmp_path, replace(network, inputs=ends[:1]))


def test_a_custom_quantity_is_refused_with_its_meaning() -> None:
    custom = replace(term("custom", 3, 1.0), name="map", meaning="Heights around the robot.")
    with pytest.raises(UserError, match=r"'terrain.map' is a custom quantity \(Heights around the robot\.\)"):
        Observer(group(1, custom, name="terrain"))


@pytest.mark.parametrize("shapes", [[()], [(0,)], [(3,), (3, 1)], [(1, 2, 2), (1, 2, 3)]])
def test_terms_that_cannot_be_concatenated_are_refused(shapes: list[tuple[int, ...]]) -> None:
    terms = [replace(term("custom", 1, 1.0), shape=shape) for shape in shapes]
    with pytest.raises(UserError, match="group 'actor': terms of the shapes .* cannot be concatenated"):
        _ = group(2, *terms).shape
    assert group(2, *(replace(t, shape=(3, 4, 5)) for t in terms)).shape == (1, 6 * len(terms), 4, 5)
