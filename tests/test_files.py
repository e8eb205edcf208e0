"""Files are written in one step, and nothing is left of one that was not."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import pytest

from humoslope.files import write_text


def test_a_signal_while_the_temporary_file_is_made_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mkstemp = tempfile.mkstemp

    def interrupted(**options: Any) -> None:
        mkstemp(**options)
        assert [path.suffix for path in tmp_path.iterdir()] == [".json"]
        raise KeyboardInterrupt

    monkeypatch.setattr(tempfile, "mkstemp", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_text(tmp_path / "walk.json", "{}")
    assert list(tmp_path.iterdir()) == []
