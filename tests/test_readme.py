"""The README is short, and the files that the tutorials tell a new user to write work as they stand there."""

from __future__ import annotations

import hashlib
import re
import shutil
import tomllib
from pathlib import Path

import pytest
import yaml
from PIL import Image

from tests import processes

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "experiments" / "examples"
APACHE_2 = "cfc7749b96f63bd31c3c42b5c471bf756814053e847c10f3eb003417bc523d30"
"""Checksum of the licence as the Apache Foundation publishes it."""
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
def test_a_tutorial_shows_its_example_as_it_is(kind):
    page = ROOT / "docs" / "tutorials" / f"{kind.removesuffix('s')}.md"
    shown = re.search(rf"```python\n# {kind}/gravel.py\n(.*?)```", page.read_text(), re.DOTALL)
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


README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_readme_is_read_in_five_minutes():
    assert len(README.split()) <= 700


def test_the_readme_begins_with_what_it_is_a_moving_picture_and_the_two_commands():
    places = [
        README.index(mark) for mark in ("# HumoSlope", ".webp)", "make train-stage1", "make test", "|*paper: Ours*|")
    ]
    assert places == sorted(places)


def test_the_picture_of_the_readme_moves_and_is_soon_loaded():
    path = ROOT / re.search(r"!\[[^]]+\]\(([^)]+)\)", README)[1]
    assert path.stat().st_size <= 1.5e6
    with Image.open(path) as picture:
        assert picture.n_frames > 25


def test_the_licence_is_that_of_the_project():
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert declared["license"] == cited["license"] == "Apache-2.0"
    assert declared["version"] == cited["version"]
    assert hashlib.sha256((ROOT / "LICENSE").read_bytes()).hexdigest() == APACHE_2
