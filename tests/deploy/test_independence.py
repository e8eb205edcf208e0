"""Playback shares nothing with the training side but the files: it is the proof that an export is complete."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

OTHERS = ("errors", "extras", "files", "interrupts", "plugins", "ranges", "screen", "seal", "shipped", "statistics")
SHARED = {f"humoslope.{name}" for name in OTHERS}
"""What it may use of the rest: sentences for mistakes, ranges of options, files and their seals, signals, an interval
for a share, what is installed and shipped, and where something can be shown."""

CODE = """
import sys
from humoslope.cli import main
assert main(["play", sys.argv[1], "--headless", "--seconds", "0.2"]) == 0
print("MODULES", *sys.modules)
"""


def test_playing_imports_no_manager_no_environment_and_no_torch(exported: Path) -> None:
    command = [sys.executable, "-c", CODE, str(exported)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "No fall in 0.2 s." in done.stdout
    modules = done.stdout.split("MODULES")[1].split()
    packages = {name.partition(".")[0] for name in modules}
    assert not packages & {"torch", "rsl_rl", "tensordict", "mjbatch", "mujoco_warp", "robots", "terrains", "tasks"}
    ours = {name for name in modules if name.startswith("humoslope.")}
    assert {name for name in ours if not name.startswith(("humoslope.deploy", "humoslope.cli"))} == SHARED
    assert {name for name in ours if name.startswith("humoslope.cli.")} == {
        "humoslope.cli.arguments",
        "humoslope.cli.play",
    }


def test_what_runs_beside_a_robot_needs_no_torch_either() -> None:
    code = "import sys, humoslope.cli.deploy, humoslope.cli.robot, humoslope.cli.doctor; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    packages = {name.partition(".")[0] for name in done.stdout.split()}
    strange = {
        "torch",
        "rsl_rl",
        "tensordict",
        "mjbatch",
        "mujoco_warp",
        "warp",
        "robots",
        "tasks",
        "unitree_interface",
    }
    assert not packages & strange
