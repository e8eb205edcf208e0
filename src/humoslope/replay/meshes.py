"""Published meshes of a robot: downloaded once from the package index, verified by hash, and kept in a cache."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import trimesh

from humoslope.downloads import Wheel, fetch
from humoslope.errors import UserError
from humoslope.files import write_text
from humoslope.replay.shapes import Shape, joined
from humoslope.scene.robot import MeshSource
from humoslope.seal import SUMS, check_sums, write_sums

CACHE = Path(".meshes")
"""Cache folder, below the current one; git ignores it."""
INDEX = "visuals.json"
"""File with the names of the robots and the mesh of each link; written after the meshes, so that a folder with it is
complete."""


def fetch_meshes(source: MeshSource, cache: Path = CACHE) -> Path:
    """Downloads the meshes of `source.robots` with pip, replacing cached ones, and returns their folder.

    Raises:
        UserError: If the package is unavailable, has another hash, or lacks a mesh.
    """
    folder = cache / source.robots[0]
    names = sorted({visual.file for visual in source.visuals})
    wheel = Wheel(source.package, source.version, source.sha256, "the meshes")
    fetched = fetch(wheel, [f"{source.folder}/{name}" for name in names])
    meshes = dict(zip(names, fetched.values(), strict=True))
    folder.mkdir(parents=True, exist_ok=True)
    for name in (INDEX, SUMS):
        (folder / name).unlink(missing_ok=True)
    for file, content in meshes.items():
        (folder / file).write_bytes(content)
    write_text(folder / "LICENCE.txt", source.licence + "\n")
    index = {"robots": source.robots, "visuals": [vars(visual) for visual in source.visuals]}
    write_text(folder / INDEX, json.dumps(index, indent=2) + "\n")
    write_sums(folder, [*meshes, INDEX])
    return folder


def load_meshes(robot: str, cache: Path = CACHE) -> dict[str, Shape]:
    """Returns the shape of each link in the link's frame.

    Raises:
        UserError: If the meshes were not fetched, or are broken.
    """
    for path in sorted(cache.glob(f"*/{INDEX}")):
        try:
            index = json.loads(path.read_text(encoding="utf-8"))
            if robot not in index["robots"]:
                continue
            check_sums(path.parent, "`humoslope meshes` fetches them anew, or")
            shapes: dict[str, list[Shape]] = {}
            for visual in index["visuals"]:
                shapes.setdefault(visual.pop("link"), []).append(_shape(path.parent, **visual))
            return {link: joined(parts) for link, parts in shapes.items()}
        except (OSError, ValueError, TypeError, KeyError):
            raise UserError(
                f"the meshes in '{path.parent}' are broken; `humoslope meshes` fetches them anew."
            ) from None
    raise UserError(f"there are no meshes of '{robot}' in '{cache}'; `humoslope meshes {robot}` fetches them.")


def _shape(folder: Path, file: str, colour: list[int], position: list[float]) -> Shape:
    mesh = trimesh.load_mesh(folder / file)
    if not len(mesh.faces):  # trimesh returns an empty mesh for most files that are none
        raise ValueError(file)
    return Shape(
        vertices=(mesh.vertices + position).astype(np.float32),
        normals=mesh.vertex_normals.astype(np.float32),
        triangles=mesh.faces.astype(np.int32),
        colours=np.tile(np.array(colour, np.uint8), (len(mesh.vertices), 1)),
    )
