"""The rollout file: what goes in comes out, and nothing else is taken for one."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.replay.rerun.rrd import provenance_text, rollout_title
from humoslope.replay.robot import RobotShape
from humoslope.replay.rollout import WIDTHS, Columns, Rollout, load_rollout
from humoslope.replay.shapes import ground_shape

MINUTE = 3000
"""Control steps."""


def said_of(path: Path) -> str:
    """The one sentence with which loading fails."""
    with pytest.raises(UserError) as caught:
        load_rollout(path)
    said = str(caught.value)
    assert said.endswith((".", "?"))
    assert "\n" not in said
    assert str(path) in said
    return said


@pytest.fixture(scope="module")
def saved(rollout: Rollout, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The arrays in the rollout's file."""
    path = tmp_path_factory.mktemp("saved") / "walk.npz"
    rollout.save(path)
    with np.load(path) as archive:
        return {name: archive[name] for name in archive.files}


def rewritten(saved: dict[str, Any], path: Path, header: dict[str, Any] | None = None, **arrays: Any) -> Path:
    """The rollout's file with a changed header, and with changed arrays; None takes one away."""
    whole = saved | arrays
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


def test_a_newer_format_is_named(saved: dict[str, Any], tmp_path: Path) -> None:
    path = rewritten(saved, tmp_path / "walk.npz", header={"version": 2})
    assert "has format 2, of a newer HumoSlope; this one reads up to 1" in said_of(path)


def test_what_is_missing_or_misshapen_is_named(rollout: Rollout, saved: dict[str, Any], tmp_path: Path) -> None:
    path, rows = tmp_path / "walk.npz", len(rollout.columns)
    assert "'com_pos_w' is missing" in said_of(rewritten(saved, path, com_pos_w=None))
    assert "'joint_pos' has shape (200, 28)" in said_of(rewritten(saved, path, joint_pos=np.zeros((rows, 28))))
    assert "'slope' has shape (199,)" in said_of(rewritten(saved, path, slope=np.zeros(rows - 1)))
    assert "no time steps" in said_of(rewritten(saved, path, time=np.zeros(0)))
    assert "'terrain_heights'" in said_of(rewritten(saved, path, terrain_heights=np.zeros(3)))
    assert "lacks 'robot.urdf'" in said_of(rewritten(saved, path, header={"robot": {"name": "g1"}}))


def header_with(rollout: Rollout, section: str, **fields: Any) -> dict[str, Any]:
    """Fields of the header, changed in one section."""
    return {section: rollout.header[section] | fields} if section else fields


@pytest.mark.parametrize(
    ("section", "fields", "said"),
    [
        ("", {"dt": 0.0}, "'dt' in its header is 0.0; it must be a positive number"),
        ("", {"dt": float("nan")}, "'dt' in its header is nan; it must be a positive number"),
        ("", {"dt": True}, "'dt' in its header is True; it must be a positive number"),
        ("", {"task": 3}, "'task' in its header is 3; it must be a text"),
        ("", {"code": None}, "'code' in its header is None; it must be a text"),
        ("", {"version": "one"}, "its format is 'one'; it must be a whole number"),
        ("", {"reward_terms": {"a": 1}}, "it must be a list of texts, all different"),
        ("", {"checkpoint": []}, "its header lacks 'checkpoint.sha256'"),
        ("checkpoint", {"iteration": "many"}, "'checkpoint.iteration' in its header is 'many'"),
        ("terrain", {"cell": -1.0}, "'terrain.cell' in its header is -1.0; it must be a positive number"),
        ("terrain", {"origin": [0.0]}, "'terrain.origin' in its header has 1 numbers; it must have 2"),
        ("terrain", {"tile_origin": "here"}, "'terrain.tile_origin' in its header is 'here'; it must be a list of num"),
        ("terrain", {"tile_length": 1e6}, "its tile does not lie within 'terrain_heights'"),
        ("terrain", {"origin": [1e6, 0.0]}, "its tile does not lie within 'terrain_heights'"),
        ("robot", {"joint_names": None}, "'robot.joint_names' in its header is None; it must be a list of texts"),
        ("robot", {"action_scale": [1.0]}, "'robot.action_scale' in its header has 1 numbers; it must have 29"),
        ("robot", {"effort_limit": [0.0] * 29}, "'robot.effort_limit' in its header is 0.0; it must be a positive"),
        ("robot", {"root": "pelvic"}, "link 'pelvic' does not exist; did you mean 'pelvis'?"),
        ("robot", {"urdf": "../../../etc/passwd"}, "its URDF cannot be read; record it anew"),
        ("robot", {"urdf": "<robot name='r'/>"}, "its URDF lacks the root; link 'pelvis' does not exist"),
    ],
)
def test_a_header_that_makes_no_sense_is_refused(
    rollout: Rollout, saved: dict[str, Any], tmp_path: Path, section: str, fields: dict[str, Any], said: str
) -> None:
    path = rewritten(saved, tmp_path / "walk.npz", header=header_with(rollout, section, **fields))
    assert said in said_of(path)


def test_a_joint_that_the_urdf_lacks_or_cannot_turn_is_named(
    rollout: Rollout, saved: dict[str, Any], tmp_path: Path
) -> None:
    path, names, urdf = tmp_path / "walk.npz", rollout.joint_names, rollout.header["robot"]["urdf"]
    other = [name.replace("left_knee", "left_kneee") for name in names]
    assert "joint 'left_kneee_joint' does not exist; did you mean 'left_knee_joint'?" in said_of(
        rewritten(saved, path, header=header_with(rollout, "robot", joint_names=other))
    )
    twice = [names[0], *names[:-1]]
    assert "it must be a list of texts, all different" in said_of(
        rewritten(saved, path, header=header_with(rollout, "robot", joint_names=twice))
    )
    sliding = re.sub(r'(name="left_knee_joint"[^>]*type=)"revolute"', r'\1"prismatic"', urdf)
    assert sliding != urdf
    assert "the type of joint 'left_knee_joint' in its URDF is 'prismatic'; it must be revolute or conti" in said_of(
        rewritten(saved, path, header=header_with(rollout, "robot", urdf=sliding))
    )
    fewer = header_with(rollout, "robot", joint_names=names[:-1])
    assert "'robot.default_joint_pos' in its header has 29 numbers; it must have 28" in said_of(
        rewritten(saved, path, header=fewer)
    )


@pytest.mark.parametrize("name", [*WIDTHS, "terrain_heights"])
def test_a_number_that_is_not_finite_or_no_number_is_refused(
    rollout: Rollout, saved: dict[str, Any], tmp_path: Path, name: str
) -> None:
    path, walk = tmp_path / "walk.npz", vars(rollout.columns) | {"terrain_heights": rollout.terrain_heights}
    whole = walk[name]
    if whole.dtype.kind == "f":
        for bad in (np.nan, np.inf, -np.inf, 1e300):
            spoilt = whole.astype(np.float64)
            spoilt[(7,) + (0,) * (whole.ndim - 1)] = bad
            path = rewritten(saved, path, **{name: spoilt})
            if name == "com_height_target" and np.isnan(bad):
                assert np.isnan(load_rollout(path).columns.com_height_target).all()
            else:
                assert f"'{name}' in row 7 is {'nan' if np.isnan(bad) else ''}" in said_of(path)
    for wrong in (whole.astype(str), whole.astype(complex)):
        assert f"'{name}' is of type {wrong.dtype}; it must be" in said_of(rewritten(saved, path, **{name: wrong}))


def test_rows_that_cannot_follow_each_other_are_refused(
    rollout: Rollout, saved: dict[str, Any], tmp_path: Path
) -> None:
    path, columns = tmp_path / "walk.npz", rollout.columns
    assert "'time' does not increase" in said_of(rewritten(saved, path, time=columns.time[::-1]))
    assert "'episode' decreases" in said_of(rewritten(saved, path, episode=columns.episode[::-1]))
    for name in ("root_quat_w", "ground_normal_w", "zmp_normal_w"):
        vectors = getattr(columns, name).copy()
        vectors[5] = 0.0
        assert f"'{name}' in row 5 is [0. 0. 0." in said_of(rewritten(saved, path, **{name: vectors}))


@pytest.mark.parametrize(
    "event", [3, {"time": 1.0}, {"time": "soon", "kind": "fall", "text": ""}, {"time": 1.0, "kind": "fall", "text": 2}]
)
def test_an_event_that_is_none_is_refused(saved: dict[str, Any], tmp_path: Path, event: Any) -> None:
    path = rewritten(saved, tmp_path / "walk.npz", header={"events": [event]})
    assert "it must be an object with time, kind and text" in said_of(path)
    assert "'events' in its header is None; it must be a list" in said_of(
        rewritten(saved, tmp_path / "walk.npz", header={"events": None})
    )


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=4,
)


@given(data=st.data(), value=json_values)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_stands_in_a_header_it_is_drawn_or_refused_in_one_sentence(
    rollout: Rollout, saved: dict[str, Any], tmp_path: Path, data: st.DataObject, value: Any
) -> None:
    header = json.loads(json.dumps(rollout.header | {"events": []}))
    place: Any = header
    while True:  # down to any field or entry
        key = data.draw(st.sampled_from(sorted(place) if isinstance(place, dict) else range(len(place))))
        inner = place[key]
        if not isinstance(inner, dict | list) or not inner or data.draw(st.booleans()):
            break
        place = inner
    place[key] = value
    path = rewritten(saved, tmp_path / "walk.npz", header=header)
    said = ""
    try:
        loaded = load_rollout(path)
        RobotShape(loaded.header["robot"]["urdf"], meshes={}).poses(loaded)
        ground_shape(loaded)
        provenance_text(loaded)
        rollout_title(loaded)
    except UserError as error:
        said = str(error)
    assert "\n" not in said


def test_a_file_from_before_contact_of_the_robot_with_itself_was_recorded_is_read(
    rollout: Rollout, tmp_path: Path
) -> None:
    rollout.save(path := tmp_path / "older.npz")
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files if name != "self_force"}
    np.savez_compressed(path, **arrays)
    assert np.isnan(load_rollout(path).columns.self_force).all()
    assert np.isfinite(rollout.columns.self_force).all()


def test_what_a_later_recording_adds_is_ignored(rollout: Rollout, saved: dict[str, Any], tmp_path: Path) -> None:
    path = rewritten(saved, tmp_path / "walk.npz", header={"weather": "fine"}, temperature=np.zeros(3))
    assert len(load_rollout(path).columns) == len(rollout.columns)
