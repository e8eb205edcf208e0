"""One whole file of every kind, made as users make them."""

from __future__ import annotations

from pathlib import Path

from humoslope.cli import main
from humoslope.learning import checkpoint
from tests.drills.processes import train


def make_files(folder: Path, actor: Path, with_run: bool = False) -> tuple[dict[str, Path], Path]:
    """A file of each kind that `damage` reads, and an export folder.

    Args:
        actor: A checkpoint of a trained policy.
        with_run: Take the checkpoint of a tiny run instead, and with it the state of its episodes.
    """
    made = actor
    if with_run:
        assert train(folder / "run", 1) == 0
        made = checkpoint.latest(folder / "run")
    out = folder / "walked"
    walk = ["--grades", "0", "--trials", "1", "--parallel-trials", "1", "--timeout-s", "0.1", "--out", str(out)]
    assert main(["evaluate", str(actor), *walk]) == 0
    rollout, export = folder / "walk.npz", folder / "export"
    assert (
        main(["record", str(actor), "--terrain", "ramp-up", "--grade", "5", "--seconds", "0.2", "--out", str(rollout)])
        == 0
    )
    assert main(["export", str(actor), "--out", str(export)]) == 0
    (trials,) = folder.glob("walked.*.npz")
    files = {
        "checkpoint": made,
        "rollout": rollout,
        "result": folder / "walked.json",
        "saved trials": trials,
    }
    if with_run:
        files["episodes"] = made.parent / "episodes_0.pt"
    return files, export
