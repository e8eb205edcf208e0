"""Published meshes of a robot: downloaded once from the package index, verified by hash, and kept in a cache."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import trimesh

from humoslope.errors import UserError
from humoslope.files import temporary_folder, write_text
from humoslope.replay.shapes import Shape, joined
from humoslope.scene.robot import MeshSource

CACHE = Path(".meshes")
"""Cache folder, below the current one; git ignores it."""
INDEX = "visuals.json"
"""File with the names of the robots and the mesh of each link; written last, so that a folder with it is complete."""


def fetch_meshes(source: MeshSource, cache: Path = CACHE) -> Path:
    """Downloads the meshes of `source.robots` with pip, replacing cached ones, and returns their folder.

    Raises:
        UserError: If the package is unavailable, has another hash, or lacks a mesh.
    """
    folder = cache / source.robots[0]
    with temporary_folder() as temporary:
        with zipfile.ZipFile(_download(source, temporary)) as wheel:
            meshes = {}
            for file in sorted({visual.file for visual in source.visuals}):
                try:
                    meshes[file] = wheel.read(f"{source.folder}/{file}")
                except KeyError:
                    raise UserError(f"{source.package} {source.version} has no {source.folder}/{file}.") from None
        folder.mkdir(parents=True, exist_ok=True)
        (folder / INDEX).unlink(missing_ok=True)
        for file, content in meshes.items():
            (folder / file).write_bytes(content)
    write_text(folder / "LICENCE.txt", source.licence + "\n")
    index = {"robots": source.robots, "visuals": [vars(visual) for visual in source.visuals]}
    write_text(folder / INDEX, json.dumps(index, indent=2) + "\n")
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


def _download(source: MeshSource, folder: Path) -> Path:
    """Returns the downloaded wheel. pip checks the hash, and uses the user's own index, proxy and certificates."""
    what = f"{source.package} {source.version}"
    wanted = folder / "wanted.txt"
    wanted.write_text(f"{source.package}=={source.version} --hash=sha256:{source.sha256}\n")
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--disable-pip-version-check"]
    options = ["--only-binary", ":all:", "--require-hashes", "--requirement", str(wanted), "--dest", str(folder)]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=False)
    if done.returncode:
        if "DO NOT MATCH THE HASHES" in done.stderr:
            raise UserError(
                f"the {what} that was downloaded does not have the SHA-256 {source.sha256}; it was not kept."
            )
        if "No module named pip" in done.stderr:
            raise UserError(f"pip is needed to fetch {what}, and is not installed for {sys.executable}.")
        raise UserError(f"{what}, which carries the meshes, could not be downloaded; is there a network?")
    return next(folder.glob("*.whl"))
