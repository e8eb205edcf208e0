"""What rerun is given can be read back, and its viewer finds nothing wrong with it."""

from __future__ import annotations

import shutil
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient
from scipy.spatial.transform import Rotation

from humoslope.errors import UserError
from humoslope.replay.rerun.rrd import write_rrd
from humoslope.replay.rerun.viewer import program
from humoslope.replay.robot import RobotShape
from humoslope.replay.rollout import Rollout

VULKAN = any(Path("/usr/share/vulkan/icd.d").glob("*.json")) or any(Path("/etc/vulkan/icd.d").glob("*.json"))
"""Whether there is a graphics driver that the viewer can draw with, such as Debian's mesa-vulkan-drivers."""

SPACE = (
    "ground",
    "followed",
    "robot/pelvis",
    "robot/left_ankle_roll_link",
    "velocity/commanded",
    "velocity/actual",
    "support/plane",
    "support/anchor",
    "support/zmp",
    "support/zmp_ray",
    "com/actual",
    "ground_normal",
    "contact/left",
    "contact/right",
)
PLOTS = ("speed", "height", "zmp", "ground", "force", "load", "reward")


def read(path: Path) -> dict[str, list[Any]]:
    """The chunks of each entity of the recording."""
    chunks: dict[str, list[Any]] = {}
    for chunk in RrdReader(path).stream():
        chunks.setdefault(str(chunk.entity_path), []).append(chunk)
    return chunks


def column(chunks: list[Any], component: str) -> tuple[np.ndarray, list[Any]]:
    """Step numbers, and values at each, of a component of an entity."""
    steps, values = [], []
    for chunk in chunks:
        table = chunk.to_record_batch()
        names = [name for name in table.schema.names if name.endswith(component)]
        if names and "step" in table.schema.names:
            steps += table.column("step").to_pylist()
            values += table.column(names[0]).to_pylist()
    order = np.argsort(steps)
    return np.array(steps)[order], [values[i] for i in order]


@pytest.fixture(scope="module")
def written(rollout: Rollout, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rrd") / "walk.rrd"
    write_rrd([rollout], path)
    return path


@pytest.fixture(scope="module")
def chunks(written: Path) -> dict[str, list[Any]]:
    return read(written)


def test_everything_is_there_on_both_timelines(chunks: dict[str, list[Any]], rollout: Rollout) -> None:
    wanted = [f"/world/{name}" for name in SPACE] + [f"/plots/{name}" for name in PLOTS] + ["/events", "/about"]
    assert set(wanted) <= set(chunks)
    moving = [entity for entity in wanted if entity not in ("/world/ground", "/about", "/events")]
    for entity in moving:
        tables = [chunk.to_record_batch() for chunk in chunks[entity] if not chunk.is_static]
        assert all({"time", "step"} <= set(table.schema.names) for table in tables)
        assert sum(table.num_rows for table in tables) == len(rollout.columns)


def test_links_are_where_the_robot_was(chunks: dict[str, list[Any]], rollout: Rollout) -> None:
    poses = RobotShape(rollout.header["robot"]["urdf"]).poses(rollout)
    steps, places = column(chunks["/world/robot/left_knee_link"], "translation")
    np.testing.assert_array_equal(steps, np.arange(1, len(rollout.columns) + 1))
    np.testing.assert_allclose(np.array(places).reshape(-1, 3), poses["left_knee_link"].position, atol=1e-5)
    _, turned = column(chunks["/world/robot/left_knee_link"], "quaternion")
    rotation = Rotation.from_quat(np.array(turned).reshape(-1, 4)).as_matrix()  # (x, y, z, w)
    np.testing.assert_allclose(rotation, poses["left_knee_link"].rotation, atol=1e-5)


def test_the_commanded_velocity_points_ahead_and_to_the_left_along_the_ground(
    altered: Callable[..., Rollout], rollout: Rollout, tmp_path: Path
) -> None:
    """Ground that rises by 30 degrees towards +x, and a robot that faces +y."""
    rows, tilt = len(rollout.columns), np.radians(30.0)
    normal = np.tile(np.array((-np.sin(tilt), 0.0, np.cos(tilt)), np.float32), (rows, 1))
    quat = np.tile(np.array((np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)), np.float32), (rows, 1))
    command = np.tile(np.array((0.5, 0.2, 0.0), np.float32), (rows, 1))
    write_rrd([altered(ground_normal_w=normal, root_quat_w=quat, command=command)], tmp_path / "walk.rrd")
    _, arrows = column(read(tmp_path / "walk.rrd")["/world/velocity/commanded"], "vectors")
    downhill = -0.2 * np.array((np.cos(tilt), 0.0, np.sin(tilt)))  # its left
    expected = np.array((0.0, 0.5, 0.0)) + downhill
    np.testing.assert_allclose(np.array(arrows).reshape(-1, 3), np.tile(expected, (rows, 1)), atol=1e-6)


def test_the_zero_moment_point_is_shown_only_where_it_is_defined(
    altered: Callable[..., Rollout], rollout: Rollout, tmp_path: Path
) -> None:
    valid = np.arange(len(rollout.columns)) % 3 > 0
    write_rrd([altered(zmp_valid=valid)], tmp_path / "walk.rrd")
    found = read(tmp_path / "walk.rrd")
    _, places = column(found["/world/support/zmp"], "positions")
    np.testing.assert_array_equal([len(place) for place in places], valid.astype(int))
    shown = np.concatenate([place for place in places if place])
    np.testing.assert_allclose(shown, rollout.columns.zmp_w[valid], atol=1e-6)


def test_a_target_height_is_shown_where_there_is_one(
    altered: Callable[..., Rollout], rollout: Rollout, tmp_path: Path
) -> None:
    target = np.full(200, 0.7, np.float32)
    write_rrd([altered(com_height_target=target)], tmp_path / "walk.rrd")
    found = read(tmp_path / "walk.rrd")
    _, bars = column(found["/world/com/target"], "strips")
    assert all(len(bar) == 1 for bar in bars)
    columns, middle = rollout.columns, np.array(bars)[:, 0].mean(axis=1)  # [T, 3] of both ends
    np.testing.assert_allclose(middle[:, :2], columns.com_pos_w[:, :2], atol=1e-5)
    np.testing.assert_allclose(middle[:, 2] - columns.com_pos_w[:, 2], 0.7 - columns.com_height, atol=1e-5)
    _, heights = column(found["/plots/height"], "scalars")
    np.testing.assert_allclose(np.array(heights)[:, 1], 0.7, atol=1e-6)


def test_events_are_at_their_moments(chunks: dict[str, list[Any]], rollout: Rollout) -> None:
    steps, texts = column(chunks["/events"], "text")
    assert [text for (text,) in texts] == [event.text for event in rollout.events]
    np.testing.assert_array_equal(steps, [round(event.time / 0.02) for event in rollout.events])


@pytest.mark.parametrize("kind", ["fall", "cause"])
def test_falls_and_their_causes_are_marked_where_and_while_they_happen(
    chunks: dict[str, list[Any]], rollout: Rollout, kind: str
) -> None:
    wanted = [event for event in rollout.events if event.kind == kind]
    assert wanted
    steps, labels = column(chunks[f"/world/failure/{kind}"], "labels")
    _, places = column(chunks[f"/world/failure/{kind}"], "positions")
    assert [text for found in labels for text in found or []] == [event.text for event in wanted]
    begun = [(step, place) for step, place in zip(steps, places, strict=True) if place]
    assert len(begun) == len(wanted)
    assert len(places) >= 2 * len(wanted) - 1  # each mark ends, but for one at the end
    assert max(steps) <= len(rollout.columns)
    for (step, (place,)), event in zip(begun, wanted, strict=True):
        assert step == round(event.time / 0.02)
        np.testing.assert_allclose(place[:2], rollout.columns.root_pos_w[step - 1, :2], atol=1e-5)


def test_two_rollouts_stand_side_by_side_on_one_timeline(rollout: Rollout, tmp_path: Path) -> None:
    write_rrd([rollout, rollout], tmp_path / "both.rrd")
    found = read(tmp_path / "both.rrd")
    for name in (*(f"world/{name}" for name in SPACE), *(f"plots/{name}" for name in PLOTS)):
        assert {f"/first/{name}", f"/second/{name}"} <= set(found)
    names = [chunk.to_record_batch() for chunk in found["/second/plots/speed"] if chunk.is_static]
    assert "2 actual" in str(names[0].to_pydict())


def test_no_more_than_two_can_be_compared(rollout: Rollout, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="3 rollouts cannot be shown at once"):
        write_rrd([rollout] * 3, tmp_path / "three.rrd")


def test_rerun_itself_can_read_the_file(written: Path) -> None:
    done = subprocess.run([program(), "rrd", "verify", str(written)], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "without error" in done.stdout + done.stderr


@pytest.mark.skipif(not VULKAN, reason="needs a Vulkan driver (Debian: mesa-vulkan-drivers)")
def test_the_viewer_reports_no_errors_in_any_view(rollout: Rollout, tmp_path: Path) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with ViewerClient.spawn(headless=True, port=port, executable_path=program()) as viewer:
        for count, views in ((1, 10), (2, 12)):
            path = tmp_path / f"{count}.rrd"
            write_rrd([rollout] * count, path)
            viewer.open(str(path))
            for _ in range(600):
                state = viewer.get_state()
                if len(state.views) == views and not state.loading:
                    break
                time.sleep(0.1)
            viewer.set_time(duration=1.0, play_state="paused")
            for _ in range(3):  # reports come with frames, and the first may tell of what is not loaded yet
                viewer.take_screenshot(max_size=200)
            state = viewer.get_state()
            assert len(state.views) == views
            assert [(view.name, view.reports) for view in state.views if view.reports] == []
            shown = next(r for r in state.recordings if r.store_id == state.active_recording)
            assert shown.current_timeline == "time"


def test_the_viewer_is_installed_with_its_package() -> None:
    assert shutil.which(program()) is not None
