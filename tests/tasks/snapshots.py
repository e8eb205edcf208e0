"""Snapshots of the resolved configuration of every registered task, for review.

`python -m tests.tasks.snapshots` writes them to tests/data/tasks; look at their differences before committing them.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from humoslope.provenance import plain
from humoslope.registry import all_tasks, build_task, load_content

FOLDER = Path(__file__).parents[1] / "data" / "tasks"
COMMAND = "python -m tests.tasks.snapshots"


def snapshot(task: str) -> dict[str, Any]:
    """The configuration of a task as JSON types. The robot is its name: it has tests of its own, and paths."""
    cfg = plain(build_task(task))
    cfg["env"]["scene"]["robot"] = cfg["env"]["scene"]["robot"]["name"]
    return json.loads(json.dumps(cfg))


def main() -> None:
    """Writes the snapshot of every task, and removes those of tasks that are gone."""
    load_content()
    FOLDER.mkdir(parents=True, exist_ok=True)
    for old in FOLDER.glob("*.json"):
        old.unlink()
    for task in all_tasks():
        (FOLDER / f"{task}.json").write_text(json.dumps(snapshot(task), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
