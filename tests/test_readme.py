"""What the README tells a new user to write works as it stands there."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]

USE = """
from humoslope.registry import build_task
terrain = build_task("HumoSlope-Gravel-Unitree-G1").env.scene.terrain.build()
assert set(terrain.kind) == {"gravel-ramp", "flat"} and terrain.grade.max() == 35.0
"""


def test_a_terrain_and_a_task_can_be_added_as_the_readme_says():
    blocks = re.findall(r"```python\n(# terrains/.*?|# tasks/.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len(blocks) == 2
    # In a process of its own: what is registered stays registered.
    program = "\n".join(["from humoslope.registry import load_content", "load_content()", *blocks, USE])
    program = program.replace("from __future__ import annotations\n", "")
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
