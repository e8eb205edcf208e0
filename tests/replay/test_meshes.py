"""Meshes are fetched from a package index on this machine."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh

from humoslope.errors import UserError
from humoslope.replay.meshes import fetch_meshes, load_meshes
from humoslope.replay.robot import RobotShape
from humoslope.replay.rollout import Rollout
from humoslope.scene.robot import MeshSource, MeshVisual
from humoslope.seal import SUMS
from robots.unitree_g1 import UNITREE_G1
from tests.package_index import index_of, toy_wheel

RED, BLUE = (255, 0, 0), (0, 0, 255)


@cache
def wheel() -> bytes:
    """A package with a box and a ball."""
    return toy_wheel(
        {
            "toys/meshes/box.STL": trimesh.creation.box((0.2, 0.4, 0.6)).export(file_type="stl"),
            "toys/meshes/ball.STL": trimesh.creation.icosphere(radius=0.1).export(file_type="stl"),
        }
    )


@pytest.fixture(scope="module")
def source() -> MeshSource:
    visuals = (
        MeshVisual("pelvis", "box.STL", RED),
        MeshVisual("torso_link", "box.STL", RED),
        MeshVisual("torso_link", "ball.STL", BLUE, (0.0, 0.0, 2.0)),
    )
    digest = hashlib.sha256(wheel()).hexdigest()
    return MeshSource(("toy", "hard_toy"), "toys", "1.0", digest, "toys/meshes", visuals, "Toys for everyone.")


@pytest.fixture
def index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    with index_of(wheel(), tmp_path, monkeypatch) as address:
        yield address


def test_fetched_meshes_are_worn_by_their_links(source: MeshSource, index: str, tmp_path: Path) -> None:
    folder = fetch_meshes(source, tmp_path / "cache")
    assert (folder / "LICENCE.txt").read_text() == "Toys for everyone.\n"
    worn = load_meshes("toy", tmp_path / "cache")
    assert set(worn) == set(load_meshes("hard_toy", tmp_path / "cache")) == {"pelvis", "torso_link"}
    np.testing.assert_allclose(np.ptp(worn["pelvis"].vertices, axis=0), (0.2, 0.4, 0.6), atol=1e-6)
    torso = worn["torso_link"]
    ball = torso.vertices[(torso.colours == BLUE).all(axis=1)]
    np.testing.assert_allclose(np.linalg.norm(ball - (0.0, 0.0, 2.0), axis=1), 0.1, atol=1e-6)
    (folder / "box.STL").write_text("not a mesh")
    with pytest.raises(UserError, match=r"box.STL' is damaged or was changed .*; `humoslope meshes` fetches them anew"):
        load_meshes("toy", tmp_path / "cache")
    (folder / SUMS).unlink()  # as an earlier version left them
    with pytest.raises(UserError, match="broken; `humoslope meshes` fetches them anew"):
        load_meshes("toy", tmp_path / "cache")


def test_a_package_with_another_hash_is_not_kept(source: MeshSource, index: str, tmp_path: Path) -> None:
    wrong = dataclasses.replace(source, sha256="0" * 64)
    with pytest.raises(
        UserError, match=r"^the toys 1\.0 that was downloaded does not have the SHA-256 0{64}; .*kept\.$"
    ):
        fetch_meshes(wrong, tmp_path / "cache")
    assert not (tmp_path / "cache").exists()


def test_a_package_without_a_mesh_is_named(source: MeshSource, index: str, tmp_path: Path) -> None:
    moved = dataclasses.replace(source, folder="toys/elsewhere")
    with pytest.raises(UserError, match="toys 1.0 has no toys/elsewhere/ball.STL"):
        fetch_meshes(moved, tmp_path / "cache")


def test_without_a_network_that_is_said(
    source: MeshSource, index: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PIP_INDEX_URL", "http://127.0.0.1:9/simple")
    with pytest.raises(UserError, match="could not be downloaded; is there a network?"):
        fetch_meshes(source, tmp_path / "cache")


def test_meshes_that_were_not_fetched_are_missed_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="there are no meshes of 'toy' in .*; `humoslope meshes toy` fetches them."):
        load_meshes("toy", tmp_path)


def test_every_link_of_the_g1_that_is_drawn_has_a_mesh(rollout: Rollout) -> None:
    assert UNITREE_G1.meshes is not None
    worn = UNITREE_G1.meshes.visuals
    assert {visual.link for visual in worn} == set(RobotShape(rollout.header["robot"]["urdf"]).shapes)
    files = [visual.file for visual in worn]
    assert len(files) == len(set(files)) == 35
