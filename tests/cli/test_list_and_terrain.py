"""What there is can be listed and drawn by its name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from humoslope.cli import VERBS, main
from humoslope.registry import all_tasks
from humoslope.terrain import registry


def test_every_task_and_terrain_is_listed_with_its_full_name(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["list"]) == 0
    words = capsys.readouterr().out.split()
    assert set(all_tasks()) <= set(words)
    assert set(registry.names()) <= set(words)


def test_a_terrain_is_drawn_by_its_name(tmp_path: Path) -> None:
    assert main(["terrain", "ramp-up", "--out", str(tmp_path / "ramp.png")]) == 0
    assert (tmp_path / "ramp.png").read_bytes().startswith(b"\x89PNG")


def test_a_misspelt_terrain_gets_its_nearest_match(mistake: Callable[..., str]) -> None:
    assert "did you mean 'ramp-up'" in mistake("terrain", "ramp-upp")


@pytest.mark.parametrize("verb", ["list", "terrain", "ramps", "evaluate", "curve"])
def test_every_verb_explains_itself(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert verb in VERBS
    with pytest.raises(SystemExit) as ended:
        main([verb, "--help"])
    assert ended.value.code == 0
    assert f"humoslope {verb}" in capsys.readouterr().out
