"""Networks that are a known matrix, and what a robot measures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from humoslope.deploy.contract import Contract
from humoslope.deploy.controller import Controller, OnnxPolicy
from humoslope.deploy.quantities import Measured

JOINTS = 29


def matrix(width: int) -> NDArray[np.float32]:
    """A matrix [29, width] whose entries are all different."""
    return (0.1 * np.random.default_rng(width).normal(size=(JOINTS, width))).astype(np.float32)


def linear(
    matrix: NDArray[np.float32], metadata: Mapping[str, str], ends: tuple[str, str] = ("obs", "actions"), batch: int = 1
) -> bytes:
    """A network whose action is `matrix` [J, d] times its input; `batch` 0 for one of any size."""
    constant = numpy_helper.from_array(np.ascontiguousarray(matrix.T), "matrix")
    node = helper.make_node("MatMul", [ends[0], "matrix"], [ends[1]])
    first, last = (
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [batch or "batch", size])
        for name, size in zip(ends, reversed(matrix.shape), strict=True)
    )
    graph = helper.make_graph([node], "linear", [first], [last], [constant])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=7)
    helper.set_model_props(model, dict(metadata))
    return bytes(model.SerializeToString())


def instants(rng: np.random.Generator, count: int) -> list[Measured]:
    """Measurements of a robot with 29 joints at so many control steps, under different commands."""
    quats = rng.normal(size=(count, 4))
    return [
        Measured(
            root_quat_w=quat / np.linalg.norm(quat),
            root_ang_vel_b=rng.normal(size=3),
            joint_pos_rel=rng.normal(size=29),
            joint_vel=rng.normal(size=29),
            command=rng.normal(size=3),
            last_action=np.zeros(29),
            root_lin_vel_b=rng.normal(size=3),
        )
        for quat in quats
    ]


def controller(folder: Path, contract: Contract) -> Controller:
    return Controller(contract, OnnxPolicy(folder, contract.network))
