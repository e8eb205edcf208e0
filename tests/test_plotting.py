"""Figures are written whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from humoslope.errors import UserError
from humoslope.evaluation.report.curve import STEPS, draw
from humoslope.plotting import new_figure, save_figure


def test_a_figure_that_fails_on_the_way_leaves_the_old_one_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"old")
    figure = new_figure()

    def half(to: Path, dpi: int) -> None:
        Path(to).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(figure, "savefig", half)
    with pytest.raises(
        UserError, match=r"cannot write '.*a.png': No space left on device; the file that was there is whole\.$"
    ):
        save_figure(figure, path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_an_unknown_format_is_a_mistake_that_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="cannot write the figure"):
        draw({"Train/reward": {0: 1.0}, STEPS: {0: 12288.0}}, "run", tmp_path / "a.nosuch")
    assert list(tmp_path.iterdir()) == []
