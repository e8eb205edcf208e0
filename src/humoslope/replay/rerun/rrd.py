"""Conversion of rollouts to a rerun recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import rerun as rr

from humoslope.errors import UserError
from humoslope.files import write_atomically
from humoslope.replay.rerun import layout
from humoslope.replay.rerun.plots import log_plots
from humoslope.replay.rerun.scene import Scene
from humoslope.replay.rollout import Rollout
from humoslope.replay.shapes import Shape

PREFIXES = ("first/", "second/")


Meshes = Sequence[Mapping[str, Shape]]
"""Of each rollout, the shape of each link, as in `RobotShape`."""


def write_rrd(rollouts: Sequence[Rollout], path: Path, meshes: Meshes | None = None) -> None:
    """Writes one rollout, or two side by side on one timeline, to an .rrd file with its layout.

    Args:
        rollouts: One or two rollouts.
        path: The file.
        meshes: Shapes instead of those in the URDFs.

    Raises:
        UserError: If there are more than two.
    """
    if not 1 <= len(rollouts) <= len(PREFIXES):
        raise UserError(f"{len(rollouts)} rollouts cannot be shown at once; give one or two.")
    write_atomically(path, lambda temporary: _write(rollouts, temporary, meshes))


def _write(rollouts: Sequence[Rollout], path: Path, meshes: Meshes | None) -> None:
    alone, names = len(rollouts) == 1, titles(rollouts)
    blueprint = layout.single(names[0]) if alone else layout.comparison(names, PREFIXES)
    # A viewer keeps one layout for each application, so that single walks and comparisons must be two.
    recording = rr.RecordingStream("humoslope" if alone else "humoslope comparison")
    recording.save(path, default_blueprint=blueprint)
    recording.send_recording_name(" and ".join(names))
    for i, rollout in enumerate(rollouts):
        scene = Scene(recording, rollout, "" if alone else PREFIXES[i], meshes[i] if meshes else None)
        scene.log()
        scene.log_about(provenance_text(rollout))
        log_plots(scene, rollout, shared="" if alone else f"{i + 1} ", pale=i > 0)
    recording.flush()
    recording.disconnect()


def titles(rollouts: Sequence[Rollout]) -> list[str]:
    """Returns the title of each rollout; numbered if there are several."""
    number = "{}: " if len(rollouts) > 1 else ""
    return [number.format(i) + rollout_title(rollout) for i, rollout in enumerate(rollouts, start=1)]


def rollout_title(rollout: Rollout) -> str:
    """Returns label, terrain and grade of a rollout."""
    terrain = rollout.header["terrain"]
    return f"{rollout.header['label']}, {terrain['name']} {terrain['grade']:g}°"


def provenance_text(rollout: Rollout) -> str:
    """Returns the origin of a walk as Markdown: policy, terrain, checkpoint, code and time."""
    header = rollout.header
    checkpoint, terrain = header["checkpoint"], header["terrain"]
    iteration = "" if checkpoint["iteration"] is None else f", iteration {checkpoint['iteration']}"
    return (
        f"**{header['label']}**, {header['task']}{iteration}\n\n"
        f"{terrain['name']} at {terrain['grade']:g}°\n\n"
        f"{checkpoint['training']}\n\n"
        f"checkpoint {checkpoint['sha256'][:12]}, {header['code'][:19]}, {header['recorded']}\n"
    )
