"""The process that `humoslope train --video-every` starts: a walk of a checkpoint, and its video, at low priority.

`python -m humoslope.cli.interval_video CHECKPOINT VIDEO`; the checkpoint is removed in the end.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from humoslope.cli import main

SECONDS = "10"
"""Length of the walk, s."""
SIZE = ("--width", "640", "--height", "360", "--fps", "20")


def draw(checkpoint: Path, video: Path) -> int:
    """Records and draws; returns the exit code of what failed, 0 if nothing did."""
    if hasattr(os, "nice"):
        os.nice(19)
    rollout = video.with_suffix(".rollout.npz")
    try:
        label = video.stem.replace("_", " ")
        walk = ("record", str(checkpoint), "--out", str(rollout), "--seconds", SECONDS, "--label", label)
        return main([*walk]) or main(["video", str(rollout), "--out", str(video), "--workers", "1", *SIZE])
    finally:
        checkpoint.unlink(missing_ok=True)


if __name__ == "__main__":
    sys.exit(draw(Path(sys.argv[1]), Path(sys.argv[2])))
