"""A terrain is drawn to a picture by its name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import terrains  # noqa: F401  registers the kinds
from humoslope.cli.terrain import terrain
from humoslope.errors import UserError
from humoslope.terrain import draw


@pytest.mark.parametrize("name", ["flat", "compound"])
def test_a_terrain_is_drawn_as_a_png_in_a_folder_that_is_made(name: str, tmp_path: Path) -> None:
    out = draw.run(name, tmp_path / "new" / name)
    assert out == tmp_path / "new" / f"{name}.png"
    assert out.read_bytes().startswith(b"\x89PNG")


def test_the_command_says_where_the_picture_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    terrain("wave")
    assert (tmp_path / "wave.png").exists()
    assert "wave.png" in capsys.readouterr().out


def test_a_terrain_nobody_registered_is_not_drawn(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="did you mean 'banked'"):
        draw.run("bankd", tmp_path / "a.png")


def test_a_picture_that_fails_half_way_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.png").write_bytes(b"old")

    def half(self: object, out: Path, **options: object) -> None:
        out.write_bytes(b"half")
        raise RuntimeError

    monkeypatch.setattr(Figure, "savefig", half)
    with pytest.raises(RuntimeError):
        draw.run("flat", tmp_path / "a.png")
    assert [(file.name, file.read_bytes()) for file in tmp_path.iterdir()] == [("a.png", b"old")]


def test_a_picture_that_cannot_be_written_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"cannot write '.*/file/a\.png': '.*/file' is a file, not a folder\.$"):
        draw.run("flat", tmp_path / "file" / "a.png")


def test_the_local_grade_of_a_plane_is_its_steepest_grade() -> None:
    x, y = np.meshgrid(np.arange(5) * 0.1, np.arange(4) * 0.1, indexing="ij")
    np.testing.assert_allclose(draw.local_grade(0.3 * x + 0.4 * y, 0.1), np.degrees(np.arctan(0.5)))


def test_a_picture_of_another_kind_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"the picture of a terrain is a PNG; '.*v1\.2' must end in \.png\.$"):
        draw.run("flat", tmp_path / "v1.2")
