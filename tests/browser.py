"""A headless browser that a test drives, if the machine has one."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
PATIENCE_S = 300.0


@contextmanager
def page(folder: Path) -> Iterator[Callable[..., dict[str, Any]]]:
    """A page of Chromium; yields call(method, **params) of its DevTools protocol.

    Args:
        folder: Where the browser may keep its profile.
    """
    assert CHROMIUM is not None
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    flags = [
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--no-first-run",
        f"--user-data-dir={folder / 'profile'}",
    ]
    command = [CHROMIUM, *flags, f"--remote-debugging-port={port}", "about:blank"]
    browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        with connect(_address(port), max_size=None, open_timeout=PATIENCE_S, ping_interval=None) as devtools:
            yield lambda method, **params: _call(devtools, method, params)
    finally:
        browser.terminate()
        browser.wait()


def _address(port: int) -> str:
    until = time.monotonic() + PATIENCE_S
    while True:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
                return str(next(tab for tab in json.load(answer) if tab["type"] == "page")["webSocketDebuggerUrl"])
        except (OSError, StopIteration):
            assert time.monotonic() < until
            time.sleep(0.2)


def _call(devtools: Any, method: str, params: dict[str, Any]) -> dict[str, Any]:
    devtools.send(json.dumps({"id": 1, "method": method, "params": params}))
    while (answer := json.loads(devtools.recv(PATIENCE_S))).get("id") != 1:
        pass
    return dict(answer["result"])
