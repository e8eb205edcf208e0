"""The live view of a training shows the robots where they are, costs little, and reads without changing anything."""

from __future__ import annotations

import dataclasses
import socket
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rerun as rr
import torch
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.replay.rerun import live
from humoslope.replay.rerun.live import LiveView, Watched, live_view
from humoslope.replay.rerun.viewer import check_port
from humoslope.replay.robot import RobotShape

PATIENCE_S = 60


@pytest.fixture(scope="module")
def env(make_stage1: Callable[..., ManagerBasedRlEnv]) -> ManagerBasedRlEnv:
    def change(cfg: EnvCfg) -> None:
        cfg.scene.terrain = dataclasses.replace(cfg.scene.terrain, levels=2, num_columns=9)

    env = make_stage1(6, change)
    for _ in range(3):
        env.step(env.zeros(29))
    return env


def to_file(env: ManagerBasedRlEnv, path: Path, watched: Callable[[float], bool] = lambda now: True) -> LiveView:
    recording = rr.RecordingStream("test")
    recording.save(path)
    return LiveView(env, recording, 3, watched)


def values(path: Path, entity: str, component: str) -> list[Any]:
    """All values of a component of an entity."""
    found: list[Any] = []
    for chunk in RrdReader(path).stream():
        if str(chunk.entity_path) == entity:
            table = chunk.to_record_batch()
            for name in table.schema.names:
                if name.endswith(component):
                    found += table.column(name).to_pylist()
    return found


def flat(state: Any, path: str = "") -> dict[str, Any]:
    """The leaves of nested dictionaries and sequences."""
    if isinstance(state, dict):
        items = [(str(name), value) for name, value in state.items()]
    elif isinstance(state, list | tuple):
        items = [(str(i), value) for i, value in enumerate(state)]
    else:
        return {path: state}
    return {name: leaf for key, value in items for name, leaf in flat(value, f"{path}/{key}").items()}


def test_robots_are_shown_where_they_are_and_nothing_is_changed(
    env: ManagerBasedRlEnv, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "RATE_HZ", 1e6)
    view = to_file(env, tmp_path / "live.rrd")
    before, random = flat(env.snapshot()), torch.get_rng_state()
    view.after_step()
    view.after_iteration(0, {"Train/reward": 1.5, "Other": 3.0})
    assert torch.equal(torch.get_rng_state(), random)
    after = flat(env.snapshot())
    assert after.keys() == before.keys()
    for name, value in before.items():
        assert np.array_equal(np.asarray(after[name]), np.asarray(value), equal_nan=isinstance(value, torch.Tensor)), (
            name
        )
    view.close(finished=True)

    assert view.sent == 1
    chosen, s = [0, 2, 4], env.signals  # spread over the columns
    robot = RobotShape(env.robot.urdf.read_text())
    state = (tensor[chosen].numpy() for tensor in (s.root_pos_w, s.root_quat_w, s.joint_pos))
    poses = robot.poses_of(env.robot.root_body, env.robot.joint_names, *state)
    path = tmp_path / "live.rrd"
    (knees,) = values(path, "/world/robot/left_knee_link", "InstancePoses3D:translations")
    np.testing.assert_allclose(knees, poses["left_knee_link"].position, atol=1e-5)
    (asked,) = values(path, "/world/commanded", "vectors")
    ahead, left = env.commands.velocity[chosen, :2].T
    cos, sin = s.heading_w[chosen].cos(), s.heading_w[chosen].sin()
    expected = torch.stack([ahead * cos - left * sin, ahead * sin + left * cos, torch.zeros(3)], dim=1)
    np.testing.assert_allclose(asked, expected, atol=1e-5)
    (turned,) = values(path, "/world/robot/left_knee_link", "InstancePoses3D:quaternions")
    rotation = Rotation.from_quat(turned).as_matrix()  # (x, y, z, w)
    np.testing.assert_allclose(rotation, poses["left_knee_link"].rotation, atol=1e-5)
    assert values(path, "/curves/reward", "scalars") == [[1.5]]
    (ground,) = values(path, "/world/ground", "vertex_positions")
    vertices = np.array(ground, np.float32)
    np.testing.assert_allclose(vertices[:, 2], env.terrain.height(torch.from_numpy(vertices[:, :2])), atol=1e-5)
    for origin in env.tiles.origin_w[chosen]:  # every shown robot has its tile
        assert (np.linalg.norm(vertices - origin.numpy(), axis=1) < env.terrain.cell).any()


def test_nothing_is_read_while_nobody_looks(
    env: ManagerBasedRlEnv, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "RATE_HZ", 1e6)
    monkeypatch.setattr(LiveView, "_send", lambda self: pytest.fail("somebody was sent to"))
    view = to_file(env, tmp_path / "live.rrd", lambda now: False)
    for _ in range(5):
        view.after_step()
    view.close(finished=False)


def test_sending_takes_no_more_than_its_share_of_time_however_slow_it_is(
    env: ManagerBasedRlEnv, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = SimpleNamespace(now=0.0, spent=0.0, each=0.0)

    def send(view: LiveView) -> None:
        clock.now += clock.each
        clock.spent += clock.each
        view.sent += 1

    monkeypatch.setattr(live, "time", SimpleNamespace(monotonic=lambda: clock.now, thread_time=lambda: clock.now))
    monkeypatch.setattr(LiveView, "_send", send)
    looks = [True]
    view = to_file(env, tmp_path / "live.rrd", lambda now: looks[0])
    for each in (0.001, 0.1, 1.0):
        clock.now, clock.spent, clock.each, view.sent = clock.now + 1.0, 0.0, each, 0
        looks[0] = False
        view.after_step()
        looks[0], until = True, clock.now + 100.0
        while clock.now < until:
            clock.now += 0.02
            view.after_step()
        assert 0 < view.sent <= 100.0 * live.RATE_HZ + 1
        assert clock.spent <= live.SHARE * 100.0 + 2.0 * each
        if each < live.SHARE / live.RATE_HZ:
            assert view.sent > 0.8 * 100.0 * live.RATE_HZ  # as often as it may
    view.close(finished=True)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux lists connections")
def test_who_looks_is_seen_by_their_connection() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        watched = Watched(port, own=0)
        assert watched.connections() == 0
        assert not watched(10.0)
        with socket.create_connection(("127.0.0.1", port)):
            assert watched.connections() == 1
            assert not watched(10.0 + 0.5 * live.LOOK_S)  # it does not look all the time
            assert watched(10.0 + 1.5 * live.LOOK_S)
            assert not Watched(port, own=1)(10.0)


def test_a_page_is_served_and_gone_with_the_training(env: ManagerBasedRlEnv) -> None:
    web_port, port = free_port(), free_port()
    with live_view(env, 2, web_port, port, "a training") as (view, address):
        assert f":{web_port}/" in address
        with urllib.request.urlopen(address, timeout=PATIENCE_S) as page:
            assert b"Rerun" in page.read()
        view.after_iteration(0, {"Train/reward": 1.0})
        assert isinstance(view.is_watched, Watched)
        if sys.platform.startswith("linux"):
            assert view.is_watched.connections() <= 1  # no more than its own, or somebody would be taken to look
        view.close(finished=True)
    for number in (web_port, port):
        check_port("port", number)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
