"""`humoslope demo`: without a display it writes a picture, and what cannot be shown is said in one sentence."""

from __future__ import annotations

import socket
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from humoslope.cli import demo, main
from humoslope.deploy import picture, views


@pytest.fixture
def blind(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """An empty folder on a machine without a display."""
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_without_a_display_it_walks_into_a_picture(
    blind: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(demo, "PICTURE_S", 2.0)
    monkeypatch.setattr(picture, "FINER", 1)
    assert main(["demo"]) == 0
    said = capsys.readouterr().out
    assert "There is no display here" in said
    assert "It walked for 2 s" in said
    assert f"wrote {blind / 'demo.png'}" in said
    assert "humoslope train HumoSlope-Stage1-Unitree-G1" in said
    pixels = np.asarray(Image.open(blind / "demo.png").convert("RGB")).astype(int)
    assert pixels.shape == (picture.HEIGHT, picture.WIDTH, 3)
    sky, ground = pixels[60:100].mean(axis=(0, 1)), pixels[-20:].mean(axis=(0, 1))
    assert sky[2] > sky[0]  # blue
    assert ground.max() < 200  # and green to grey
    assert (pixels.max(axis=2) < 70).sum() > 100  # dark parts of the robot


def test_what_cannot_be_shown_is_said_in_one_sentence(
    mistake: Callable[..., str], blind: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("glfw.init", lambda: False)
    assert "there is no display to open a window on" in mistake("demo", "--view", "window")
    assert "there is no gamepad" in mistake("demo", "--view", "window", "--gamepad", "nothing")
    assert "cannot write" in mistake("demo", "--picture", f"{__file__}/picture.png")
    assert "play: grade is 70; it must be between" in mistake("demo", "--grade", "70")


def test_a_port_in_use_is_said_in_one_sentence(mistake: Callable[..., str], blind: Path) -> None:
    pytest.importorskip("mjviser", reason="needs the extra [view]")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        assert f"port {port} cannot be used" in mistake("demo", "--view", "browser", "--port", port)


@pytest.mark.parametrize(
    ("display", "mjviser", "kind"),
    [(False, True, None), (True, True, "browser"), (True, False, "window")],
)
def test_the_browser_is_preferred_where_there_is_a_display(
    display: bool, mjviser: bool, kind: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(views, "has_display", lambda: display)
    monkeypatch.setattr(views, "installed", lambda package: mjviser)
    assert views.chosen("auto") == kind
    assert views.chosen("window") == "window"
