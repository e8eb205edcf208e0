"""An actor as ONNX, and how far the two are apart."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from humoslope.deploy.controller import load_network
from humoslope.learning.policy import GROUP, Actor

INPUT, OUTPUT = "obs", "actions"
"""Names of its ends. Unitree's deployment feeds what it calls "obs"."""
OPSET = 18
"""rsl_rl's own; onnxruntime 1.22, which Unitree's deployment uses, runs it."""


def translate(actor: Actor) -> bytes:
    """The actor with its normaliser as an ONNX file, one observation [1, d] to one action [1, J], weights inside.

    The first dimension is fixed: Unitree's deployment takes the sizes of its buffers from the shape.
    """
    trained: Any = actor.module
    module = trained.as_onnx(verbose=False).cpu().eval()
    logger = logging.getLogger("torch.onnx._internal.exporter._registration")
    level = logger.level
    logger.setLevel(logging.ERROR)  # it warns of operators of a package that is not needed here
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            program = torch.onnx.export(
                module, module.get_dummy_inputs(), input_names=[INPUT], output_names=[OUTPUT], opset_version=OPSET
            )
    finally:
        logger.setLevel(level)
    assert program is not None
    return bytes(program.model_proto.SerializeToString())


def largest_difference(content: bytes, actor: Actor, observations: Tensor) -> float:
    """Largest absolute difference between the actions of an ONNX file and of the actor, over `observations` [K, d]."""
    session = load_network(content, "the ONNX file")
    expected = actor(TensorDict({GROUP: observations}, batch_size=[len(observations)])).cpu().numpy()
    given = np.concatenate([session.run(None, {INPUT: row[None]})[0] for row in observations.cpu().numpy()])
    return float(np.abs(given - expected).max())
