"""Videos and contact sheets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from humoslope.errors import UserError
from humoslope.replay.film.follow import follow
from humoslope.replay.film.frames import Frames
from humoslope.replay.film.video import GAP, VideoCfg, contact_sheet, write_sheet, write_video
from humoslope.replay.rollout import Rollout

SMALL = {"width": 160, "height": 90, "workers": 1}


def test_a_video_has_a_picture_for_every_moment(rollout: Rollout, tmp_path: Path) -> None:
    path, drawn = tmp_path / "walk.mp4", []
    write_video(rollout, path, VideoCfg(start=1.0, seconds=0.8, fps=10.0, **SMALL), lambda: drawn.append(1))
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(path)
    assert (frames, len(drawn)) == (8, 8)
    assert seconds == pytest.approx(0.8, abs=0.11)
    reader = imageio_ffmpeg.read_frames(path)
    about = next(reader)
    assert (about["size"], about["codec"], about["pix_fmt"].split("(")[0]) == ((160, 90), "h264", "yuv420p")
    first = np.frombuffer(next(reader), np.uint8).reshape(90, 160, 3)
    drawn_anew = Frames(rollout, 160, 90)(49)
    assert np.abs(first.astype(int) - drawn_anew).mean() < 6.0


@pytest.mark.parametrize(("fps", "every"), [(50.0, 1), (25.0, 2), (10.0, 5)])
def test_pictures_are_evenly_spaced(rollout: Rollout, fps: float, every: int) -> None:
    steps = VideoCfg(fps=fps).steps(rollout)
    assert set(np.diff(steps)) == {every}


@pytest.mark.parametrize("fps", [30.0, 60.0, 100.0])
def test_a_gif_that_would_play_at_another_speed_is_refused(rollout: Rollout, tmp_path: Path, fps: float) -> None:
    with pytest.raises(UserError, match=f"video: fps is {fps:g}; a GIF shows each picture for whole hundredths"):
        write_video(rollout, tmp_path / "walk.gif", VideoCfg(fps=fps, **SMALL))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", ["gif", "webp"])
def test_a_web_page_gets_an_animated_picture(rollout: Rollout, tmp_path: Path, ending: str) -> None:
    path, drawn = tmp_path / f"walk.{ending}", []
    write_video(rollout, path, VideoCfg(start=1.0, seconds=0.5, fps=4.0, **SMALL), lambda: drawn.append(1))
    with Image.open(path) as picture:
        assert (picture.format, picture.size) == (ending.upper(), (160, 90))
        assert (picture.n_frames, len(drawn)) == (2, 2)
        picture.seek(1)
        picture.load()
        assert picture.info["duration"] == 250
        assert picture.info["loop"] == 0
        shown = np.asarray(picture.convert("RGB")).astype(int)
    assert np.abs(shown - Frames(rollout, 160, 90)(62)).mean() < 12.0


def test_two_processes_draw_what_one_does(rollout: Rollout, tmp_path: Path) -> None:
    for workers in (1, 2):
        cfg = VideoCfg(**SMALL | {"workers": workers})
        write_sheet(rollout, tmp_path / f"{workers}.png", cfg)
    alone, together = (np.asarray(Image.open(tmp_path / f"{workers}.png")) for workers in (1, 2))
    np.testing.assert_array_equal(alone, together)
    assert alone.shape == (2 * 90 + GAP, 3 * 160 + 2 * GAP, 3)


def test_a_contact_sheet_shows_its_pictures_row_by_row() -> None:
    sheet = contact_sheet([np.full((4, 5, 3), shade, np.uint8) for shade in range(6)])
    assert [sheet[y, x, 0] for y in (0, 4 + GAP) for x in (0, 5 + GAP, 10 + 2 * GAP)] == list(range(6))
    assert (sheet[4 : 4 + GAP] == 255).all()


def test_the_robot_stays_in_the_middle_of_the_picture(rollout: Rollout) -> None:
    frames = Frames(rollout, 320, 180)
    for step in (0, 45, 100):
        picture = frames(step).astype(int)
        grey = (np.ptp(picture, axis=2) < 12) & (picture.mean(axis=2) < 215)  # neither sky nor ground
        grey[:50] = False  # the caption
        rows, columns = np.nonzero(grey)
        assert 0.35 < columns.mean() / 320 < 0.65
        assert 0.35 < rows.mean() / 180 < 0.75


def test_the_camera_follows_without_bobbing_and_does_not_fly_between_falls(altered: Callable[..., Rollout]) -> None:
    time = np.arange(200) * 0.02
    place = np.stack([0.5 * time, 0.0 * time, 0.75 + 0.02 * np.sin(2 * np.pi * 3.0 * time)], axis=1).astype(np.float32)
    place[120:, 0] += 10.0
    episode = (np.arange(200) >= 120).astype(np.int32)
    seen = follow(altered(root_pos_w=place, episode=episode).columns, 0.02)
    assert np.ptp(seen[40:80, 2]) < 0.002
    assert seen[119, 0] < 1.3
    assert seen[120, 0] > 11.0


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"fps": 0.0}, "fps is 0"),
        ({"width": 961}, "width is 961; it must be even"),
        ({"height": 10}, "height is 10"),
        ({"start": -1.0}, "start is -1; it must be 0 or more"),
        ({"workers": -1}, "workers is -1"),
        ({"start": 9.0}, "start is 9 s, but the rollout ends at 4 s"),
    ],
)
def test_an_impossible_video_is_said_in_one_sentence(rollout: Rollout, wrong: dict[str, float], said: str) -> None:
    with pytest.raises(UserError, match=said):
        VideoCfg(**wrong).steps(rollout)


def test_a_missing_ffmpeg_is_said_in_one_sentence(
    rollout: Rollout, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "no-ffmpeg"))
    with pytest.raises(UserError, match="ffmpeg could not write the video"):
        write_video(rollout, tmp_path / "walk.mp4", VideoCfg(seconds=0.1, **SMALL))
    assert list(tmp_path.iterdir()) == []
