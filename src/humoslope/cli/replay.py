"""`humoslope replay ROLLOUT`: shows a recorded walk in rerun."""

from __future__ import annotations

import dataclasses
import threading
import webbrowser
from pathlib import Path

import tyro

from humoslope.files import check_place, temporary_folder
from humoslope.replay.meshes import load_meshes
from humoslope.replay.rerun.rrd import write_rrd
from humoslope.replay.rerun.viewer import open_window, served
from humoslope.replay.rollout import load_rollout
from humoslope.screen import has_display


@dataclasses.dataclass(frozen=True)
class Options:
    """Shows a recorded walk in rerun, alone or beside another one.

    Attributes:
        rollout: Path of a rollout, a file of `humoslope record`.
        other: Path of a second rollout, shown beside the first on the same timeline.
        save: Path of a rerun recording to write, such as walk.rrd, instead of showing anything; any rerun viewer opens
            it.
        web: Show it in a browser on this machine instead of a window.
        web_port: TCP port of the web page.
        port: TCP port of the recording, which the web page fetches.
        meshes: Draw the robot with the meshes that `humoslope meshes` has fetched.
    """

    rollout: tyro.conf.Positional[Path]
    other: Path | None = None
    save: Path | None = None
    web: bool = False
    web_port: int = 9090
    port: int = 9877
    meshes: bool = False


def run(arguments: list[str]) -> None:
    """Shows the rollout named in `arguments`."""
    options = tyro.cli(Options, args=arguments, prog="humoslope replay")
    if options.save is not None:
        check_place(options.save)
    rollouts = [load_rollout(path) for path in (options.rollout, options.other) if path is not None]
    meshes = [load_meshes(rollout.header["robot"]["name"]) for rollout in rollouts] if options.meshes else None
    if options.save is not None:
        write_rrd(rollouts, options.save, meshes)
        print(f"wrote {options.save} ({options.save.stat().st_size / 1e6:.1f} MB)")
        return
    with temporary_folder() as folder:
        path = folder / f"{options.rollout.stem}.rrd"
        write_rrd(rollouts, path, meshes)
        if not options.web:
            open_window(path)
            return
        with served(path, options.web_port, options.port) as address:
            print(f"{address}\nCtrl-C ends it.", flush=True)
            if has_display():  # otherwise Python would open a browser in the terminal
                webbrowser.open(address)
            threading.Event().wait()
