"""Observations are put together as the contract says, and the network is the one it was written for."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from humoslope.deploy.contract import Contract, Observation, Term
from humoslope.deploy.controller import Observer, Policy
from humoslope.deploy.quantities import Measured
from humoslope.errors import UserError
from humoslope.slope import quaternion


def term(quantity: str, size: int, scale: float) -> Term:
    return Term(quantity, quantity, "", "", ("1",), tuple("abc"[:size]), scale, 0.0)


def observation(history: int) -> Observation:
    return Observation(
        history,
        "terms in this order; of each term all frames, oldest first",
        "all frames equal the first one",
        (term("velocity_command", 3, 1.0), term("joint_velocity", 3, 0.5)),
    )


def at(measured: Measured, step: int) -> Measured:
    """A measurement whose every number tells of its step."""
    return replace(measured, command=np.array([step, step, step]) + 0.25, joint_vel=np.array([2, 4, 6]) * step)


def test_a_term_keeps_its_frames_together_oldest_first(measured: Measured) -> None:
    observe = Observer(observation(history=3))
    for step in range(1, 6):
        seen = observe(at(measured, step))
    assert seen.dtype == np.float32
    np.testing.assert_array_equal(seen[:9].reshape(3, 3), np.array([[3.25], [4.25], [5.25]]) * np.ones(3))
    np.testing.assert_array_equal(seen[9:].reshape(3, 3), np.array([[3], [4], [5]]) * np.array([1.0, 2.0, 3.0]))


def test_the_first_frame_fills_the_history_and_again_after_a_reset(measured: Measured) -> None:
    observe = Observer(observation(history=3))
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
    with pytest.raises(UserError, match=r"policy.onnx' does not exist; it belongs to the export folder"):
        Policy(tmp_path, contract.network)
    with pytest.raises(UserError, match="is not the network that the contract beside it was written for"):
        Policy(exported, replace(contract.network, sha256="0" * 64))
    with pytest.raises(UserError, match=r"has the inputs obs \[1, 480\]; by the contract it has obs \[1, 96\] alone"):
        Policy(exported, replace(contract.network, inputs=96))
    with pytest.raises(UserError, match=r"has the outputs actions \[1, 29\]; by the contract it has torques"):
        Policy(exported, replace(contract.network, output="torques"))


@pytest.mark.parametrize("content", [b"", b"no network", bytes(1000)])
def test_a_file_that_is_no_network_is_refused(spoil: Callable[..., Path], contract: Contract, content: bytes) -> None:
    folder = spoil(network=content)
    import hashlib

    network = replace(contract.network, sha256=hashlib.sha256(content).hexdigest())
    with pytest.raises(UserError, match="is no network that onnxruntime can run: ") as error:
        Policy(folder, network)
    assert "\n" not in str(error.value)
