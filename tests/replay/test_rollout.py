"""The rollout file: what goes in comes out, and nothing else is taken for one."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from humoslope.errors import UserError
from humoslope.replay.rollout import WIDTHS, Columns, Rollout, load_rollout

MINUTE = 3000
"""Control steps."""


def said_of(path: Path) -> str:
    """The one sentence that loading ends with."""
    with pytest.raises(UserError) as caught:
        load_rollout(path)
    said = str(caught.value)
    assert said.endswith(".")
    assert "\n" not in said
    assert str(path) in said
    return said


def rewritten(rollout: Rollout, path: Path, header: dict[str, Any] | None = None, **arrays: Any) -> Path:
    """The rollout's file with a changed header, and with changed arrays; None takes one away."""
    rollout.save(path)
    with np.load(path) as archive:
        whole = {name: archive[name] for name in archive.files} | arrays
    if header is not None:
        whole["header"] = np.array(json.dumps(json.loads(str(whole["header"])) | header))
    with path.open("wb") as file:
        np.savez(file, **{name: array for name, array in whole.items() if array is not None})
    return path


def test_what_is_saved_is_loaded(rollout: Rollout, tmp_path: Path) -> None:
    path = tmp_path / "walk.npz"
    rollout.save(path)
    again = load_rollout(path)
    for field in dataclasses.fields(Columns):
        np.testing.assert_array_equal(getattr(again.columns, field.name), getattr(rollout.columns, field.name))
    np.testing.assert_array_equal(again.terrain_heights, rollout.terrain_heights)
    assert again.events == rollout.events
    assert again.header["robot"] == json.loads(json.dumps(rollout.header["robot"]))
    assert again.header["checkpoint"]["sha256"] == "ab" * 32


def test_a_minute_on_the_track_takes_less_than_10_MB_whatever_happens(rollout: Rollout, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    sizes = {"J": len(rollout.joint_names), "R": len(rollout.header["reward_terms"])}
    noise = {
        name: rng.standard_normal((MINUTE, *(sizes.get(n, n) for n in width))).astype(np.float32)
        for name, width in WIDTHS.items()
    }
    heights = rng.standard_normal((820, 240)).astype(np.float32)  # 35 m x 6 m in cells of 5 cm, with its border
    dataclasses.replace(rollout, columns=Columns(**noise), terrain_heights=heights).save(tmp_path / "noise.npz")
    assert (tmp_path / "noise.npz").stat().st_size < 10e6


def test_a_file_that_is_no_rollout_is_said_to_be_none(tmp_path: Path) -> None:
    path = tmp_path / "walk.npz"
    assert "does not exist" in said_of(path)
    path.write_text("hello")
    assert "broken or truncated" in said_of(path)
    path.write_bytes(b"")
    assert "broken or truncated" in said_of(path)
    np.savez(path, qpos=np.zeros(3))
    assert "is not a HumoSlope rollout" in said_of(path)
    np.savez(path, header=np.array(json.dumps({"format": "other"})))
    assert "is not a HumoSlope rollout" in said_of(path)
    np.savez(path, header=np.array([object()]))  # would have to be unpickled
    assert "broken or truncated" in said_of(path)
    with path.open("wb") as file:
        np.save(file, np.zeros(3))
    assert "broken or truncated" in said_of(path)


def test_a_file_that_was_cut_off_is_broken(rollout: Rollout, tmp_path: Path) -> None:
    rollout.save(tmp_path / "walk.npz")
    whole = (tmp_path / "walk.npz").read_bytes()
    for share in (0.1, 0.5, 0.999):
        (tmp_path / "cut.npz").write_bytes(whole[: int(share * len(whole))])
        assert "broken or truncated" in said_of(tmp_path / "cut.npz")


def test_a_flipped_byte_is_found(rollout: Rollout, tmp_path: Path) -> None:
    rollout.save(tmp_path / "walk.npz")
    whole = bytearray((tmp_path / "walk.npz").read_bytes())
    whole[len(whole) // 2] ^= 0xFF
    (tmp_path / "flipped.npz").write_bytes(whole)
    assert "broken or truncated" in said_of(tmp_path / "flipped.npz")


def test_a_newer_format_is_named(rollout: Rollout, tmp_path: Path) -> None:
    path = rewritten(rollout, tmp_path / "walk.npz", header={"version": 2})
    assert "has format 2, of a newer HumoSlope; this one reads up to 1" in said_of(path)


def test_what_is_missing_or_misshapen_is_named(rollout: Rollout, tmp_path: Path) -> None:
    path, rows = tmp_path / "walk.npz", len(rollout.columns)
    assert "'com_pos_w' is missing" in said_of(rewritten(rollout, path, com_pos_w=None))
    assert "'joint_pos' has shape (200, 28)" in said_of(rewritten(rollout, path, joint_pos=np.zeros((rows, 28))))
    assert "'slope' has shape (199,)" in said_of(rewritten(rollout, path, slope=np.zeros(rows - 1)))
    assert "no time steps" in said_of(rewritten(rollout, path, time=np.zeros(0)))
    assert "'terrain_heights'" in said_of(rewritten(rollout, path, terrain_heights=np.zeros(3)))
    assert "lacks 'robot.urdf'" in said_of(rewritten(rollout, path, header={"robot": {"name": "g1"}}))


def test_what_a_later_recording_adds_is_ignored(rollout: Rollout, tmp_path: Path) -> None:
    path = rewritten(rollout, tmp_path / "walk.npz", header={"weather": "fine"}, temperature=np.zeros(3))
    assert len(load_rollout(path).columns) == len(rollout.columns)
