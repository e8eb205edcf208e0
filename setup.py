"""Puts what lies beside the code of a checkout into the wheel, as the package's folder `content`.

Tasks, terrains and robots are top-level folders of a checkout, and imported as `tasks`, `terrains` and `robots`.
Packages of such names must not lie beside those of others, so the wheel has them, and the shipped results of trainings,
inside of `humoslope`, from where `humoslope.shipped` puts them on the import path. An editable installation uses the
checkout.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

HERE = Path(__file__).resolve().parent
CONTENT = (
    *("tasks", "terrains", "robots"),
    *("experiments/checkpoints/stage1.pt", "experiments/checkpoints/stage1.swing.json"),
    *("experiments/checkpoints/stage2.pt", "experiments/exports/stage2"),
    *("experiments/rollouts/stage2_track20.npz", "experiments/paper.json", "experiments/results/stage1_curve.csv"),
)
COMMIT = "commit.txt"


class BuildWithContent(build_py):
    """The build of the package's Python files, and of its content."""

    def run(self) -> None:
        super().run()
        if self.editable_mode:
            return
        folder = Path(self.build_lib) / "humoslope" / "content"
        shutil.rmtree(folder, ignore_errors=True)  # of an earlier build
        for name in CONTENT:
            source, target = HERE / name, folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            if source.is_dir():
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__", ".*"))
            else:
                shutil.copyfile(source, target)
        (folder / COMMIT).write_text(f"commit {_commit()}\n", encoding="utf-8")


def _commit() -> str:
    """The commit of the checkout; "unknown" of an archive of its files."""
    try:
        done = subprocess.run(
            ["git", "-C", str(HERE), "rev-parse", "--show-toplevel", "HEAD"], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    top, commit = done.stdout.split("\n")[:2]
    return commit if Path(top) == HERE else "unknown"


setup(cmdclass={"build_py": BuildWithContent})
