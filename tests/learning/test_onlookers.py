"""Whoever looks on changes nothing in a training, and cannot end it."""

from __future__ import annotations

import io
import os
import socket
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rerun as rr
import torch
from rich.console import Console

from humoslope.cli import interval_video, main
from humoslope.cli.train import TrainArgs, _check_looking
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.learning import checkpoint, videos
from humoslope.learning.trainer import Trainer
from humoslope.learning.videos import IntervalVideos
from humoslope.replay.rerun import live

ROOT = Path(__file__).parents[2]


def test_a_training_that_is_watched_and_filmed_is_the_same_to_the_last_bit(
    train: Callable[..., Path], finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    views: list[live.LiveView] = []

    @contextmanager
    def seen(env: ManagerBasedRlEnv, worlds: int, web_port: int, port: int, title: str) -> Iterator[Any]:
        recording = rr.RecordingStream(title)
        recording.save(tmp_path / "live.rrd")
        views.append(live.LiveView(env, recording, worlds, lambda now: True))
        yield views[0], "http://somewhere"

    monkeypatch.setattr(live, "live_view", seen)
    monkeypatch.setattr(live, "RATE_HZ", 1e6)
    monkeypatch.setattr(live, "SHARE", 1e6)
    monkeypatch.setattr(videos, "MODULE", "tests.learning.finished_video")
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{ROOT / 'src'}")
    run = train(tmp_path / "seen", "--agent.max-iterations", "3", "--watch", "--web-port", "9", "--port", "10",
                "--video-every", "2")  # fmt: skip
    assert views[0].sent == 12
    ours, theirs = (checkpoint.load(folder / "model_2.pt") for folder in (run, finished))
    for name, weights in theirs["policy"]["weights"].items():
        assert torch.equal(ours["policy"]["weights"][name], weights), name
    assert torch.equal(ours["rng"]["torch"], theirs["rng"]["torch"])
    assert sorted(path.name for path in (run / "videos").iterdir()) == ["iteration_2.mp4", "log.txt"]
    assert (run / "videos" / "iteration_2.mp4").read_bytes() == b"PK\x03\x04"  # of the checkpoint that it was given
    said = (run / "console.log").read_text()
    assert "Live view: http://somewhere" in said
    assert "iteration_2.mp4" in said
    assert "watch" not in (run / "starts" / "1" / "options.txt").read_text()  # it is not an option of the run


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"watch": True, "watch_worlds": 0}, "--watch-worlds is 0; it must be at least 1"),
        ({"watch": True, "port": 9090}, "both 9090; they must differ"),
        ({"video_every": -1}, "--video-every is -1; it must be 0 or more"),
    ],
)
def test_an_impossible_wish_is_said_before_anything_is_built(options: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said):
        _check_looking(TrainArgs(**options))


def test_a_port_in_use_is_said_in_one_sentence_and_leaves_no_run(
    task: str, tiny: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        run = tmp_path / "run"
        assert main(["train", task, "--run-dir", str(run), *tiny, "--watch", "--web-port", port]) == 2
    assert f"port {port} cannot be used" in capsys.readouterr().err
    assert not run.exists()


def test_an_onlooker_that_fails_is_dismissed() -> None:
    class Clumsy:
        def after_step(self) -> None:
            raise OSError("the viewer is gone")

    quiet = SimpleNamespace(after_step=lambda: None)
    out = io.StringIO()
    trainer: Any = SimpleNamespace(onlookers=[Clumsy(), quiet], _console=Console(file=out, width=200))
    Trainer._show(trainer, lambda onlooker: onlooker.after_step())
    assert trainer.onlookers == [quiet]
    assert out.getvalue() == "Clumsy is given up (OSError: the viewer is gone).\n"


class Process:
    """A drawing process whose end the test decides."""

    started: list[list[str]] = []

    def __init__(self, command: list[str], **options: Any) -> None:
        self.started.append(command)
        self.options, self.returncode, self.terminated = options, 0, False
        self.running = True

    def poll(self) -> int | None:
        return None if self.running else self.returncode

    def wait(self) -> int:
        self.running = False
        return self.returncode

    def terminate(self) -> None:
        self.terminated, self.returncode = True, -15


@pytest.fixture
def filmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[IntervalVideos, io.StringIO]:
    """Videos every third iteration, and what is said of them."""
    monkeypatch.setattr(subprocess, "Popen", Process)
    Process.started = []
    out = io.StringIO()
    (tmp_path / "videos").mkdir()
    return IntervalVideos(tmp_path, 3, lambda path: path.touch(), Console(file=out, width=200)), out


def test_videos_are_drawn_at_intervals_and_one_at_a_time(filmed: tuple[IntervalVideos, io.StringIO]) -> None:
    film, out = filmed
    for iteration in range(9):
        film.after_iteration(iteration, {})
        if iteration == 6:
            film._process.running = False  # type: ignore[union-attr]
    assert [Path(command[-1]).name for command in Process.started] == ["iteration_3.mp4", "iteration_9.mp4"]
    assert "No video of iteration 6: the one before is still being drawn." in out.getvalue()
    assert "videos/iteration_3.mp4" in out.getvalue()
    assert film._process is not None
    assert film._process.options["start_new_session"]  # type: ignore[attr-defined]
    film.close(finished=True)
    assert "Waiting for" in out.getvalue()
    assert out.getvalue().count("wrote") == 2


def test_a_video_that_fails_is_told_and_one_of_a_stopped_training_is_given_up(
    filmed: tuple[IntervalVideos, io.StringIO],
) -> None:
    film, out = filmed
    film.after_iteration(2, {})
    process: Any = film._process
    process.running, process.returncode = False, 2
    film.after_iteration(5, {})
    assert "iteration_3.mp4 was not drawn" in out.getvalue()
    assert "log.txt says why" in out.getvalue()
    last: Any = film._process
    film.close(finished=False)
    assert last.terminated
    assert "wrote" not in out.getvalue()


def test_the_process_records_a_walk_and_draws_it_at_the_lowest_priority(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[Any] = []
    monkeypatch.setattr(os, "nice", done.append)
    monkeypatch.setattr(interval_video, "main", lambda words: done.append(words[:2]) or 0)
    path, video = tmp_path / "iteration_5.pt", tmp_path / "iteration_5.mp4"
    path.touch()
    assert interval_video.draw(path, video) == 0
    assert done == [19, ["record", str(path)], ["video", str(tmp_path / "iteration_5.rollout.npz")]]
    assert not path.exists()
    monkeypatch.setattr(interval_video, "main", lambda words: done.append(words[0]) or 2)
    assert interval_video.draw(path, video) == 2
    assert done[-2:] == [19, "record"]
