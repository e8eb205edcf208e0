"""Rollouts as a rerun recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import rerun as rr

from humoslope.errors import UserError
from humoslope.files import write_atomically
from humoslope.replay import layout
from humoslope.replay.plots import log_plots
from humoslope.replay.rollout import Rollout
from humoslope.replay.scene import Scene

PREFIXES = ("first/", "second/")


def write_rrd(rollouts: Sequence[Rollout], path: Path) -> None:
    """Writes one rollout, or two side by side on one timeline, as an .rrd file with its layout.

    Raises:
        UserError: If there are more than two.
    """
    if not 1 <= len(rollouts) <= len(PREFIXES):
        raise UserError(f"{len(rollouts)} rollouts cannot be shown at once; give one or two.")
    write_atomically(path, lambda temporary: _write(rollouts, temporary))


def _write(rollouts: Sequence[Rollout], path: Path) -> None:
    names = names_of(rollouts)
    starts = [rollout.columns.root_pos_w[0].tolist() for rollout in rollouts]
    root = rollouts[0].header["robot"]["root"]
    if len(rollouts) == 1:
        blueprint = layout.single(root, starts[0])
    else:
        blueprint = layout.comparison(names, PREFIXES, root, starts)
    # A viewer keeps one layout for each application, so that single walks and comparisons must be two.
    application = "humoslope" if len(rollouts) == 1 else "humoslope comparison"
    recording = rr.RecordingStream(application)
    recording.save(path, default_blueprint=blueprint)
    recording.send_recording_name(" and ".join(names))
    for i, rollout in enumerate(rollouts):
        alone = len(rollouts) == 1
        scene = Scene(recording, rollout, "" if alone else PREFIXES[i])
        scene.log()
        log_plots(scene, rollout, label="" if alone else f"{names[i]}: ", pale=i > 0)
        about = rr.TextDocument(describe(rollout), media_type=rr.MediaType.MARKDOWN)
        recording.log(("" if alone else PREFIXES[i]) + "about", about, static=True)
    recording.flush()
    recording.disconnect()


def names_of(rollouts: Sequence[Rollout]) -> list[str]:
    """What the viewer calls each rollout: its label, with the ground where labels are the same."""
    labels = [rollout.header["label"] for rollout in rollouts]
    if len(set(labels)) == len(labels):
        return labels
    grounds = [f"{r.header['terrain']['name']} {r.header['terrain']['grade']:g}°" for r in rollouts]
    return [f"{label} on {ground}" for label, ground in zip(labels, grounds, strict=True)]


def describe(rollout: Rollout) -> str:
    """Whose walk this is, as Markdown."""
    header = rollout.header
    checkpoint, terrain = header["checkpoint"], header["terrain"]
    return (
        f"**{header['label']}**, {header['task']}, iteration {checkpoint['iteration']}\n\n"
        f"{terrain['name']} at {terrain['grade']:g}°\n\n"
        f"{checkpoint['training']}\n\n"
        f"checkpoint {checkpoint['sha256'][:12]}, {header['code'][:19]}, {header['recorded']}\n"
    )
