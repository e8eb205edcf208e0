"""`humoslope record`, `replay` and `video`, one after the other as a user types them, and their mistakes."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from humoslope.cli import main
from humoslope.replay.rollout import load_rollout
from tests import processes

SHORT = ("--terrain", "rough-ramp-up", "--grade", "15", "--seconds", "1")


@pytest.fixture(scope="module")
def walked(untrained: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `record` writes by default."""
    checkpoint = Path(shutil.copy(untrained, tmp_path_factory.mktemp("walk")))
    assert main(["record", str(checkpoint), *SHORT]) == 0
    return checkpoint.with_name("model_0.rough-ramp-up-15.rollout.npz")


def test_a_recording_lands_beside_its_checkpoint_and_says_whose_it_is(walked: Path) -> None:
    rollout, checkpoint = load_rollout(walked), walked.with_name("model_0.pt")
    header = rollout.header
    assert len(rollout.columns) <= 50
    assert header["task"] == "HumoSlope-Stage1-Unitree-G1"
    assert header["checkpoint"]["sha256"] == hashlib.sha256(checkpoint.read_bytes()).hexdigest()
    assert header["checkpoint"]["harness"] == 1.0
    assert "training used the harness" in header["checkpoint"]["training"]
    assert (header["physics"]["cone"], header["physics"]["timestep"]) == ("elliptic", 0.005)
    assert (header["terrain"]["name"], header["terrain"]["grade"]) == ("rough-ramp-up", 15.0)
    assert header["label"] == "model_0"


def test_the_same_seed_records_the_same_walk(untrained: Path, walked: Path, tmp_path: Path) -> None:
    for seed in ("0", "1"):
        assert main(["record", str(untrained), *SHORT, "--seed", seed, "--out", str(tmp_path / f"{seed}.npz")]) == 0
    first, again, other = (load_rollout(p).columns.joint_pos for p in (walked, tmp_path / "0.npz", tmp_path / "1.npz"))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_replay_saves_a_recording_for_any_rerun_viewer(
    walked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "walk.rrd"
    assert main(["replay", str(walked), "--other", str(walked), "--save", str(out)]) == 0
    assert out.stat().st_size > 100_000
    assert f"wrote {out}" in capsys.readouterr().out


def test_video_writes_a_video_and_a_contact_sheet(
    walked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "walk.mp4"
    small = ("--width", "96", "--height", "64", "--fps", "5", "--workers", "1")
    assert main(["video", str(walked), "--out", str(out), *small]) == 0
    assert out.stat().st_size > 1000
    assert Image.open(tmp_path / "walk.png").width > 3 * 96
    assert f"wrote {out}" in capsys.readouterr().out.replace("\n", "")


def test_a_sheet_alone_is_soon_there(walked: Path) -> None:
    assert main(["video", str(walked), "--sheet-only", "--width", "96", "--height", "64", "--workers", "1"]) == 0
    assert walked.with_name("model_0.rough-ramp-up-15.png").is_file()
    assert not walked.with_name("model_0.rough-ramp-up-15.mp4").exists()


@pytest.mark.parametrize(("stop", "workers"), [(signal.SIGTERM, "2"), (signal.SIGINT, "1"), (signal.SIGHUP, "1")])
def test_a_video_that_is_stopped_leaves_no_file_behind(
    walked: Path, tmp_path: Path, stop: signal.Signals, workers: str
) -> None:
    with np.load(walked) as archive:  # as a walk so long that its video does not end by itself
        np.savez(tmp_path / "walk.npz", **dict(archive) | {"time": 60.0 * archive["time"]})
    options = ("--width", "480", "--height", "270", "--fps", "100", "--workers", workers)
    video = processes.start("video", str(tmp_path / "walk.npz"), *options)
    while not list(tmp_path.glob(".walk.mp4.*")):  # it is being written
        assert video.poll() is None
        time.sleep(0.01)
    os.kill(video.pid, stop)
    ended = video.wait(patience_s=300.0)  # it must not outlive the test, whatever happens
    assert ended.returncode == 128 + stop
    assert ended.stderr == ("humoslope: interrupted.\n" if stop is signal.SIGINT else "humoslope: terminated.\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["walk.npz", "walk.png"]


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_rollout_that_cannot_be_drawn_is_refused_in_one_sentence_by_every_verb(
    mistake: Callable[..., str], walked: Path, tmp_path: Path, workers: str
) -> None:
    with np.load(walked) as archive:
        whole = {name: archive[name] for name in archive.files}
    header = json.loads(str(whole["header"]))
    header["robot"]["urdf"] = header["robot"]["urdf"].replace('<child link="torso_link"/>', '<child link="head"/>')
    np.savez(tmp_path / "loose.npz", **whole | {"header": np.array(json.dumps(header))})
    small = ("--width", "96", "--height", "64", "--workers", workers)
    assert "URDF cannot be read" in mistake("video", str(tmp_path / "loose.npz"), *small)
    assert "URDF cannot be read" in mistake("replay", str(tmp_path / "loose.npz"), "--save", str(tmp_path / "walk.rrd"))
    whole["joint_pos"][3, 5] = np.nan
    np.savez(tmp_path / "nan.npz", **whole)
    for verb in ("video", "replay"):
        assert "'joint_pos' in row 3 is nan; it must be finite" in mistake(verb, str(tmp_path / "nan.npz"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["loose.npz", "nan.npz"]


@pytest.mark.parametrize("verb", ["replay", "video"])
def test_what_is_no_rollout_is_said_in_one_sentence(mistake: Callable[..., str], tmp_path: Path, verb: str) -> None:
    assert "does not exist" in mistake(verb, str(tmp_path / "missing.npz"))
    (tmp_path / "text.npz").write_text("hello")
    assert "is broken or truncated" in mistake(verb, str(tmp_path / "text.npz"))
    np.savez(tmp_path / "foreign.npz", header=np.array(json.dumps({"a": 1})))
    assert "is not a HumoSlope rollout" in mistake(verb, str(tmp_path / "foreign.npz"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("record", "{checkpoint}", "--terrain", "ramp-upp"), "did you mean 'ramp-up'"),
        (("record", "{checkpoint}", "--grade", "60"), "must be between 0 and 32 degrees"),
        (("record", "{checkpoint}", "--level", "2"), "level is 2; it must be between 0 and 1"),
        (("record", "{checkpoint}", "--out", "."), "is a folder"),
        (("record", "nowhere.pt"), "does not exist"),
        (("replay", "{walk}", "--save", "."), "is a folder"),
        (("replay", "{walk}", "--other", "nowhere.npz", "--save", "walk.rrd"), "does not exist"),
        (("replay", "{walk}", "--web", "--port", "0"), "--port is 0"),
        (("video", "{walk}", "--out", "walk.avi"), "must end in .mp4, .gif or .webp"),
        (("video", "{walk}", "--fps", "1000"), "fps is 1000"),
        (("video", "{walk}", "--start", "100"), "the rollout ends at"),
    ],
)
def test_a_mistake_is_said_in_one_sentence(
    mistake: Callable[..., str], untrained: Path, walked: Path, words: tuple[str, ...], said: str
) -> None:
    assert said in mistake(*(word.format(checkpoint=untrained, walk=walked) for word in words))


def test_without_a_display_replay_says_how_else_to_look(
    mistake: Callable[..., str], walked: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    assert "there is no display" in mistake("replay", str(walked))


def test_web_tells_the_address_and_serves_until_it_is_interrupted(
    walked: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Interrupted:
        def wait(self) -> None:
            raise KeyboardInterrupt

    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("humoslope.cli.replay.threading.Event", Interrupted)
    monkeypatch.setattr("humoslope.cli.replay.served", lambda path, web, port: nullcontext(f"http://{web}/{port}"))
    assert main(["replay", str(walked), "--web", "--web-port", "9191", "--port", "9192"]) == 130
    assert capsys.readouterr().out == "http://9191/9192\nCtrl-C ends it.\n"


def test_meshes_are_asked_for_by_the_name_of_a_robot(
    mistake: Callable[..., str], walked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "robot with meshes 'unitree_g2' does not exist; did you mean 'unitree_g1'?" in mistake(
        "meshes", "unitree_g2"
    )
    assert "`humoslope meshes unitree_g1_solid` fetches them" in mistake(
        "replay", str(walked), "--meshes", "--save", "walk.rrd"
    )
    fetched = []
    monkeypatch.setattr("humoslope.cli.meshes.fetch_meshes", lambda source: fetched.append(source.robots) or Path("."))
    for arguments in (["meshes"], ["meshes", "unitree_g1"], ["meshes", "unitree_g1_solid"]):
        assert main(arguments) == 0
    assert fetched == [("unitree_g1", "unitree_g1_solid")] * 3
