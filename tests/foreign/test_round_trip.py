"""Our own export, taken for a policy from outside, acts as the export itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest

from humoslope.cli import main
from humoslope.deploy import contract as contracts
from tests.foreign.linear import controller, instants


@pytest.mark.parametrize("source", ["exported/policy.onnx", "params/deploy.yaml", "."])
def test_the_same_measurements_give_the_same_targets(exported: Path, source: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main(["import", str(exported / source), "--out", str(out)]) == 0
    own, again = contracts.read(exported), contracts.read(out)
    assert again.joints == own.joints
    assert [replace(term, name="", training_noise=0.0) for term in again.observations[0].terms] == [
        replace(term, name="", training_noise=0.0) for term in own.observations[0].terms
    ]
    assert again.timing == own.timing
    ours, theirs = controller(exported, own), controller(out, again)
    for measured in instants(np.random.default_rng(0), 7):  # longer than the history
        targets = ours(replace(measured, last_action=ours.last_action))
        np.testing.assert_allclose(theirs(replace(measured, last_action=theirs.last_action)), targets, atol=1e-6)
    assert (out / "params" / "deploy.yaml").is_file()
    assert onnx.load(out / "exported" / "policy.onnx").metadata_props
    assert again.training.sha256 == own.network.sha256
    assert again.training.iteration is None


def test_an_import_plays_and_says_where_it_comes_from(
    exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "guest"
    assert main(["import", str(exported / "exported" / "policy.onnx"), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert said.startswith(
        "policy, from outside (mjlab), on unitree_g1_solid: 6 observations of 5 steps, 480 numbers ->"
    )
    assert main(["play", str(out), "--headless", "--seconds", "0.5"]) == 0
    said = capsys.readouterr().out
    assert "policy, from outside (mjlab), on unitree_g1_solid\n" in said
    assert "No fall in 0.5 s." in said
