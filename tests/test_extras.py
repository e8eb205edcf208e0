"""A missing package is one sentence with the command that installs it, and the base needs none of them."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from humoslope import extras
from humoslope.errors import UserError
from humoslope.learning.ppo import PpoCfg

ROOT = Path(__file__).parents[1]
BASE = [
    "train",
    "list",
    "ramps",
    "evaluate",
    "calibrate",
    "table",
    "record",
    "upgrade",
    "play",
    "demo",
    "margins",
    "bench",
]
ABSENT = """
import json, sys
from contextlib import redirect_stderr
from io import StringIO


class Without:
    def __init__(self, finder):
        self.finder = finder

    def find_spec(self, name, *more):
        return None if name.partition(".")[0] in absent else self.finder.find_spec(name, *more)

    def __getattr__(self, name):
        return getattr(self.finder, name)


absent = json.loads(sys.argv[1])
sys.meta_path[:] = map(Without, sys.meta_path)
from importlib import import_module
from humoslope.cli import main

said = {}
for name, arguments in json.loads(sys.argv[2]).items():
    with redirect_stderr(StringIO()) as err:
        code = main(arguments)
    said[name] = [code, err.getvalue()]
for verb in json.loads(sys.argv[3]):
    import_module(f"humoslope.cli.{verb}")
print(json.dumps(said))
"""


def test_verbs_say_what_they_lack_and_the_base_needs_none_of_it(tmp_path: Path) -> None:
    rollout = str(ROOT / "experiments" / "rollouts" / "stage2_track20.npz")
    commands = {
        "replay": ["replay", rollout, "--save", str(tmp_path / "walk.rrd")],
        "video": ["video", rollout, "--out", str(tmp_path / "walk.mp4")],
        "terrain": ["terrain", "ramp-up", "--out", str(tmp_path / "ramp.png")],
        "demo": ["demo", "--view", "browser"],
    }
    arguments = [json.dumps(value) for value in (sorted(extras.EXTRAS), commands, BASE)]
    done = subprocess.run(
        [sys.executable, "-c", ABSENT, *arguments], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    for verb, (code, said) in json.loads(done.stdout.splitlines()[-1]).items():
        assert code == 2, verb
        who = "--view browser" if verb == "demo" else verb
        assert said.startswith(f"humoslope: {who} needs the package ")
        assert said.endswith(", which is not installed: pip install 'humoslope[view]'.\n")
        assert said.count("\n") == 1


def test_every_extra_exists() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(extras.EXTRAS.values()) <= set(project["optional-dependencies"])


def test_wandb_is_asked_for_before_a_training_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    with pytest.raises(
        UserError, match=r"agent.logger 'wandb' needs the package wandb.*pip install 'humoslope\[wandb\]'"
    ):
        PpoCfg(logger="wandb").check()


def test_what_fails_inside_of_a_package_is_not_hidden() -> None:
    with pytest.raises(ModuleNotFoundError, match="numpy_typo"), extras.explained_extras("it"):
        raise ModuleNotFoundError("No module named 'numpy_typo'", name="numpy_typo")
