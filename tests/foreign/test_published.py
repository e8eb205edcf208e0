"""A published policy is fetched by its name and its hash, from a package index on this machine."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from humoslope.cli import main
from humoslope.deploy import contract as contracts
from humoslope.downloads import Wheel, fetch
from humoslope.errors import UserError
from humoslope.foreign import source
from humoslope.foreign.published import PublishedPolicy
from robots.unitree_g1.policies import HOLOSOMA_FASTSAC, HOLOSOMA_G1, HOLOSOMA_PPO
from tests.foreign.linear import linear, matrix
from tests.foreign.test_formats import holosoma_metadata
from tests.package_index import index_of, toy_wheel

FILE = "toys/walk.onnx"


def test_a_policy_is_imported_by_its_name_if_its_hash_is_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    network = linear(matrix(100), holosoma_metadata(), ("actor_obs", "action"))
    wheel = toy_wheel({FILE: network})
    right = Wheel("toys", "1.0", hashlib.sha256(wheel).hexdigest(), "the policies")
    toy = PublishedPolicy("toy-walk", right, FILE, "It was trained on a carpet.", "For everyone.")
    content_of = source.content_of

    def with_toy(kind: type) -> list[object]:
        return [*content_of(kind), *([toy] if kind is PublishedPolicy else [])]

    monkeypatch.setattr(source, "content_of", with_toy)
    monkeypatch.chdir(tmp_path)
    with index_of(wheel, tmp_path, monkeypatch):
        assert main(["import", "toy-walk"]) == 0
        said = capsys.readouterr().out
        assert "toy-walk, from outside (toys 1.0), on unitree_g1_solid: 9 observations, 100 numbers" in said
        assert "It was trained on a carpet.\nFor everyone.\nwrote toy-walk; humoslope play toy-walk" in said
        training = contracts.read(tmp_path / "toy-walk").training
        assert (training.task, training.checkpoint) == ("toy-walk", "walk.onnx")
        assert training.sha256 == hashlib.sha256(network).hexdigest()

        toy = replace(toy, wheel=replace(right, sha256="0" * 64))
        assert main(["import", "toy-walk", "--out", "wrong"]) == 2
        assert "the toys 1.0 that was downloaded does not have the SHA-256 0000" in capsys.readouterr().err
        assert not (tmp_path / "wrong").exists()
        with pytest.raises(UserError, match=r"toys 1\.0 has no toys/run\.onnx"):
            fetch(right, ["toys/run.onnx"])


def test_the_published_policies_are_those_of_holosoma() -> None:
    assert (HOLOSOMA_PPO.name, HOLOSOMA_FASTSAC.name) == ("holosoma-ppo", "holosoma-fastsac")
    for policy in (HOLOSOMA_PPO, HOLOSOMA_FASTSAC):
        assert policy in source.content_of(PublishedPolicy)
        assert len(policy.wheel.sha256) == 64
    assert set(HOLOSOMA_G1.default) <= set(HOLOSOMA_G1.joints)
