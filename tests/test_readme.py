"""What the README tells a new user to write works as it stands there."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from tests import processes

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "experiments" / "examples"
TINY = [
    *("--preset", "cpu", "--env.num-envs", "4", "--env.sim.device", "cpu", "--env.scene.terrain.levels", "2"),
    *("--env.scene.terrain.num-columns", "2", "--agent.num-steps-per-env", "4", "--agent.num-learning-epochs", "1"),
    *("--agent.num-mini-batches", "2", "--agent.hidden-dims", "16", "16", "--agent.max-iterations", "1"),
]


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """What a user has after adding the two example files; returns how to run `humoslope` there."""
    for folder in ("src", "robots", "terrains", "tasks"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for kind in ("terrains", "tasks"):
        shutil.copy(EXAMPLES / kind / "gravel.py", tmp_path / kind)
    monkeypatch.chdir(tmp_path)

    def humoslope(*arguments: str) -> str:
        done = processes.run(*arguments, path=(tmp_path / "src", tmp_path))
        assert done.returncode == 0, done.stderr
        return done.stdout

    return humoslope


@pytest.mark.parametrize("kind", ["terrains", "tasks"])
def test_the_readme_shows_the_examples_as_they_are(kind):
    shown = re.search(rf"```python\n# {kind}/gravel.py\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert shown is not None
    assert shown[1] == (EXAMPLES / kind / "gravel.py").read_text()


def test_a_terrain_and_a_task_are_added_by_a_file_each(checkout, tmp_path):
    listed = checkout("list")
    assert "gravel-ramp" in listed
    assert "HumoSlope-Gravel-Unitree-G1" in listed
    checkout("terrain", "gravel-ramp", "--out", "gravel.png")
    assert (tmp_path / "gravel.png").read_bytes().startswith(b"\x89PNG")
    checkout("train", "HumoSlope-Gravel-Unitree-G1", "--run-dir", "run", *TINY)
    assert (tmp_path / "run" / "model_0.pt").is_file()
