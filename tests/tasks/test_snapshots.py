"""Every registered task is what was reviewed."""

from __future__ import annotations

import json

import pytest

from humoslope.registry import all_tasks, load_content
from tests.tasks.snapshots import COMMAND, FOLDER, snapshot

load_content()
TASKS = list(all_tasks())


def differences(there: object, here: object, path: str = "") -> list[str]:
    """A line for each place at which two plain configurations differ."""
    if isinstance(there, dict) and isinstance(here, dict):
        keys = {**there, **here}
        return [d for key in keys for d in differences(there.get(key), here.get(key), f"{path}.{key}")]
    return [] if there == here else [f"{path.removeprefix('.')}: {there} -> {here}"]


@pytest.mark.parametrize("task", TASKS)
def test_a_task_is_configured_as_it_was_reviewed(task: str) -> None:
    file = FOLDER / f"{task}.json"
    reviewed = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    found, own = differences(reviewed, snapshot(task)), list(snapshot(task)["env"]["rewards"])
    said = f"{task} is not what was reviewed; if it is meant so, run `{COMMAND}` and review {file.name}:"
    assert not found, "\n".join([said, *found])
    assert list(reviewed["env"]["rewards"]) == own  # their order is that of the columns of logs


def test_no_snapshot_is_left_of_a_task_that_is_gone() -> None:
    assert {file.stem for file in FOLDER.glob("*.json")} == set(TASKS), f"run `{COMMAND}`"
