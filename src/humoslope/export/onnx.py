"""Conversion of an actor to ONNX, and comparison of the two."""

from __future__ import annotations

import contextlib
import copy
import io
import logging
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import onnx
import torch
from tensordict import TensorDict
from torch import Tensor, nn

from humoslope.deploy.contract import NetworkInput
from humoslope.deploy.controller import load_network
from humoslope.export.folder import OUTPUT
from humoslope.learning.policy import Actor

INPUT = "obs"
"""Name of the input, if it is a single vector, as Unitree's deployment has it."""
OPSET = 18
"""rsl_rl's own; onnxruntime 1.22, which Unitree's deployment uses, runs it."""


def network_inputs(actor: Actor, observations: TensorDict) -> tuple[NetworkInput, ...]:
    """Returns the inputs of the ONNX file of `actor`, one for each observation group that it reads.

    A single vector is called "obs", any other input by its group. The first dimension is fixed to 1, because Unitree's
    deployment derives the sizes of its buffers from the shape.

    Args:
        actor: The actor.
        observations: Observations of every group it reads, of any batch size.
    """
    groups = actor.spec.groups
    shapes = {group: (1, *observations[group].shape[1:]) for group in groups}
    if _one_vector(actor, observations):
        return (NetworkInput(INPUT, groups[0], shapes[groups[0]]),)
    return tuple(NetworkInput(group, group, shapes[group]) for group in groups)


def _one_vector(actor: Actor, observations: TensorDict) -> bool:
    return len(actor.spec.groups) == 1 and observations[actor.spec.groups[0]].ndim == 2


class _NamedInputs(nn.Module):
    """A module that takes a tensor for each observation group, around one that takes a TensorDict.

    Args:
        module: The module to wrap; copied, so that the caller's stays on its device.
        groups: Names of the groups in the order of the arguments.
    """

    def __init__(self, module: nn.Module, groups: tuple[str, ...]) -> None:
        super().__init__()
        self.module, self.groups = copy.deepcopy(module), groups

    def forward(self, *tensors: Tensor) -> Tensor:
        action: Tensor = self.module(TensorDict(dict(zip(self.groups, tensors, strict=True)), batch_size=[1]))
        return action


def translate(actor: Actor, observations: TensorDict) -> bytes:
    """Returns the actor with its normaliser as an ONNX file of batch size 1, weights inside.

    Args:
        actor: The actor.
        observations: Observations of every group it reads, for the shapes.
    """
    inputs = network_inputs(actor, observations)
    module: Any
    if _one_vector(actor, observations) and hasattr(actor.module, "as_onnx"):
        trained: Any = actor.module
        module = trained.as_onnx(verbose=False)
    else:
        module = _NamedInputs(actor.module, actor.spec.groups)
    dummies = tuple(torch.zeros(end.shape) for end in inputs)
    logger = logging.getLogger("torch.onnx._internal.exporter._registration")
    level = logger.level
    logger.setLevel(logging.ERROR)  # it warns of operators of a package that is not needed here
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            program = torch.onnx.export(
                module.cpu().eval(),
                dummies,
                input_names=[end.name for end in inputs],
                output_names=[OUTPUT],
                opset_version=OPSET,
            )
    finally:
        logger.setLevel(level)
    assert program is not None
    model = program.model_proto
    # The exporter notes stack traces with the paths of this machine at every node.
    for part in (*model.graph.node, *model.graph.value_info, *model.graph.input, *model.graph.output, model.graph):
        part.ClearField("metadata_props")
    return bytes(model.SerializeToString())


def with_metadata(content: bytes, metadata: Mapping[str, str]) -> bytes:
    """Returns an ONNX file with these texts as its metadata, instead of any that it had."""
    model = onnx.load_from_string(content)
    onnx.helper.set_model_props(model, dict(metadata))
    return bytes(model.SerializeToString())


def largest_difference(content: bytes, actor: Actor, observations: TensorDict) -> float:
    """Returns the largest absolute difference between the actions of an ONNX file and of the actor.

    Args:
        content: The ONNX file.
        actor: The actor.
        observations: Observations to compare on, batch size [K].
    """
    session = load_network(content, "the ONNX file")
    arrays = {end.name: observations[end.group].cpu().numpy() for end in network_inputs(actor, observations)}
    expected = actor(observations).cpu().numpy()
    rows = [{name: array[k : k + 1] for name, array in arrays.items()} for k in range(len(expected))]
    given = np.concatenate([session.run([OUTPUT], row)[0] for row in rows])
    return float(np.abs(given - expected).max())
