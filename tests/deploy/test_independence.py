"""Playback shares nothing with the training side but the files: it is the proof that an export is complete."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

OTHERS = ("errors", "extras", "files", "interrupts", "plugins", "ranges", "screen", "seal", "shipped", "statistics")
SHARED = {f"humoslope.{name}" for name in OTHERS}
"""What it may use of the rest: sentences for mistakes, ranges of options, files and their seals, signals, an interval
for a share, what is installed and shipped, and where something can be shown."""

CODE = """
import sys
from humoslope.cli import main
assert main(["play", sys.argv[1], "--headless", "--seconds", "0.2"]) == 0
print("MODULES", *sys.modules)
import humoslope.cli.deploy, humoslope.cli.robot, humoslope.cli.doctor
print("MODULES", *sys.modules)
"""


@pytest.fixture(scope="module")
def done(exported: Path) -> list[str]:
    """What `play` printed, the modules that were loaded then, and those when also the verbs beside a robot were."""
    command = [sys.executable, "-c", CODE, str(exported)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split("MODULES")


def test_playing_imports_no_manager_no_environment_and_no_torch(done: list[str]) -> None:
    assert "No fall in 0.2 s." in done[0]
    modules = done[1].split()
    packages = {name.partition(".")[0] for name in modules}
    assert not packages & {"torch", "rsl_rl", "tensordict", "mjbatch", "mujoco_warp", "robots", "terrains", "tasks"}
    ours = {name for name in modules if name.startswith("humoslope.")}
    assert {name for name in ours if not name.startswith(("humoslope.deploy", "humoslope.cli"))} == SHARED
    assert {name for name in ours if name.startswith("humoslope.cli.")} == {
        "humoslope.cli.arguments",
        "humoslope.cli.play",
    }


def test_what_runs_beside_a_robot_needs_no_torch_either(done: list[str]) -> None:
    packages = {name.partition(".")[0] for name in done[2].split()}
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
