"""Opening the viewer: what is served, and what is said where it cannot run."""

from __future__ import annotations

import base64
import json
import shutil
import socket
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import parse_qs, urlparse

import numpy as np
import pytest
from PIL import Image
from websockets.sync.client import connect

from humoslope.errors import UserError
from humoslope.replay.rerun import viewer
from humoslope.replay.rerun.rrd import write_rrd
from humoslope.replay.rollout import Rollout

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
PATIENCE_S = 60


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="module")
def recording(rollout: Rollout, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("viewer") / "walk.rrd"
    write_rrd([rollout], path)
    return path


@pytest.fixture
def broken_viewer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A viewer that says what is written to the file, and fails."""
    says = tmp_path / "says.txt"
    script = tmp_path / "rerun"
    script.write_text(f"#!/bin/sh\ncat {says} >&2\nexit 3\n")
    script.chmod(0o755)
    monkeypatch.setattr(viewer, "program", lambda: str(script))
    monkeypatch.setenv("DISPLAY", ":77")
    return says


def test_without_a_display_other_ways_to_look_are_named(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(UserError, match="no display; look from a browser with --web"):
        viewer.open_window(recording)


def test_a_missing_graphics_driver_is_said_in_one_sentence(recording: Path, broken_viewer: Path) -> None:
    for said in ("panicked\nNo graphics adapter was found", "Error: The GPU/graphics driver is lacking some abilities"):
        broken_viewer.write_text(said)
        with pytest.raises(UserError, match="no graphics driver it can draw with; install one for Vulkan"):
            viewer.open_window(recording)


def test_a_viewer_that_fails_is_quoted(recording: Path, broken_viewer: Path) -> None:
    broken_viewer.write_text("starting\nthe disk is full.\n")
    with pytest.raises(UserError, match="ended with code 3: the disk is full.$"):
        viewer.open_window(recording)
    with pytest.raises(UserError, match="ended with code 3"), viewer.served(recording, free_port(), free_port()):
        pass


def test_a_port_in_use_is_named_with_its_option(recording: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(UserError, match=f"port {port} cannot be used .*in use.*choose another with --web-port"):
            viewer.served(recording, port, free_port()).__enter__()
        with pytest.raises(UserError, match=f"port {port} cannot be used .*choose another with --port"):
            viewer.served(recording, free_port(), port).__enter__()


def test_impossible_ports_are_named(recording: Path) -> None:
    with pytest.raises(UserError, match="--port is 70000"):
        viewer.check_port("port", 70000)
    with pytest.raises(UserError, match="both 9090"):
        viewer.served(recording, 9090, 9090).__enter__()


def test_a_browser_is_given_the_page_and_the_recording_and_both_go_when_done(recording: Path) -> None:
    web_port, port = free_port(), free_port()
    with viewer.served(recording, web_port, port) as address:
        assert urlparse(address).port == web_port
        with urllib.request.urlopen(address, timeout=PATIENCE_S) as page:
            assert b"Rerun" in page.read()
        (file,) = parse_qs(urlparse(address).query)["url"]
        with urllib.request.urlopen(file, timeout=PATIENCE_S) as answer:
            assert answer.read() == recording.read_bytes()
            assert answer.headers["Access-Control-Allow-Origin"] == f"http://127.0.0.1:{web_port}"
    for number in (web_port, port):
        viewer.check_port("port", number)


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium (Debian: chromium)")
def test_a_headless_browser_shows_the_walk(recording: Path, tmp_path: Path) -> None:
    assert CHROMIUM is not None
    debug = free_port()
    flags = ["--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    own = ["--window-size=960,540", f"--remote-debugging-port={debug}", f"--user-data-dir={tmp_path / 'profile'}"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with viewer.served(recording, free_port(), free_port()) as address:
        browser = subprocess.Popen([CHROMIUM, *flags, *own, "about:blank"], **quiet)
        try:
            assert _shows_colours(debug, address, tmp_path / "page.png")
        finally:
            browser.terminate()
            browser.wait()


def _shows_colours(debug: int, address: str, picture: Path) -> bool:
    """Whether the page comes to show the blue of the commanded velocity and the orange of the actual one."""
    until = time.monotonic() + PATIENCE_S
    while True:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{debug}/json") as answer:
                page = next(tab for tab in json.load(answer) if tab["type"] == "page")
            break
        except OSError:
            assert time.monotonic() < until
            time.sleep(0.2)
    with connect(page["webSocketDebuggerUrl"], max_size=None) as devtools:

        def call(number: int, method: str, **params: object) -> dict[str, str]:
            devtools.send(json.dumps({"id": number, "method": method, "params": params}))
            while (answer := json.loads(devtools.recv())).get("id") != number:
                pass
            return answer["result"]

        call(1, "Page.navigate", url=address)
        while time.monotonic() < until:
            time.sleep(0.5)
            picture.write_bytes(base64.b64decode(call(2, "Page.captureScreenshot")["data"]))
            pixels = np.asarray(Image.open(picture).convert("RGB")).reshape(-1, 3).astype(int)
            blue, orange = (np.abs(pixels - colour).max(axis=1) < 40 for colour in ((66, 133, 244), (251, 140, 0)))
            if blue.sum() > 50 and orange.sum() > 50:
                return True
    return False
