"""Display of a recording in rerun's viewer, in a window or in a browser."""

from __future__ import annotations

import shutil
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import IO
from urllib.parse import quote

import rerun_cli

from humoslope.errors import UserError
from humoslope.extras import missing
from humoslope.files import temporary_folder
from humoslope.interrupts import die_with_parent
from humoslope.screen import HOST, check_port, has_display

PROGRAMS = ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun")
"""Paths of the viewer in its package, on different systems."""
START_S = 60.0
"""Longest time until the page is available, s."""
SERVED = "walk.rrd"


def open_window(path: Path) -> None:
    """Shows a recording in a window, until it is closed.

    Raises:
        UserError: If there is no display, or the viewer does not run on this machine.
    """
    if not has_display():
        raise UserError(
            "there is no display; look from a browser with --web, elsewhere with --save FILE.rrd, "
            "or make a video with `humoslope video`."
        )
    with tempfile.TemporaryFile("w+") as said:
        command = [program(), str(path), "--port", "auto", "--bind", HOST]
        done = subprocess.run(command, stderr=said, check=False, preexec_fn=die_with_parent)
        if done.returncode:
            raise _failure(done.returncode, said)


@contextmanager
def served(path: Path, web_port: int, port: int) -> Iterator[str]:
    """Serves a recording and rerun's page for it while the context lasts; yields the address of the page.

    The page fetches the file as a whole. rerun could also stream it, but then the viewer starts at its end.

    Args:
        path: The recording.
        web_port: Port of the page.
        port: Port of the recording.

    Raises:
        UserError: If a port is in use, or the page does not come up.
    """
    check_ports(web_port, port)
    with temporary_folder() as folder, tempfile.TemporaryFile("w+") as said:
        shutil.copyfile(path, folder / SERVED)
        files = ThreadingHTTPServer((HOST, port), partial(_Files, f"http://{HOST}:{web_port}", directory=folder))
        threading.Thread(target=files.serve_forever, daemon=True).start()
        recording = f"http://{HOST}:{port}/{SERVED}"
        command = [program(), recording, "--serve-web", "--bind", HOST, "--web-viewer-port", str(web_port)]
        # Between fork and exec it only calls functions of the C library.
        page = subprocess.Popen(command, stdout=said, stderr=said, preexec_fn=die_with_parent)  # noqa: PLW1509
        try:
            wait_for_page(page, web_port, said)
            yield f"http://{HOST}:{web_port}/?url={quote(recording, safe='')}"
        finally:
            page.terminate()
            page.wait()
            files.shutdown()
            files.server_close()


class _Files(SimpleHTTPRequestHandler):
    """Serves the files of a folder to the viewer's page and to no other."""

    def __init__(self, origin: str, *args: object, **keywords: object) -> None:
        self._origin = origin
        super().__init__(*args, **keywords)  # type: ignore[arg-type]

    def end_headers(self) -> None:
        self.send_header("Access-Control-Allow-Origin", self._origin)
        super().end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Does not log requests."""


def check_ports(web_port: int, port: int) -> None:
    """Checks that both ports can be listened on.

    Raises:
        UserError: If they cannot.
    """
    if web_port == port:
        raise UserError(f"--web-port and --port are both {port}; they must differ.")
    for option, number in (("web-port", web_port), ("port", port)):
        check_port(option, number)


def wait_for_page(page: subprocess.Popen[bytes], web_port: int, said: IO[str]) -> None:
    """Waits until the viewer's server listens on a port.

    Args:
        said: What the server has said, for the message.

    Raises:
        UserError: If it ends before, or takes longer than `START_S`.
    """
    until = time.monotonic() + START_S
    while time.monotonic() < until:
        if page.poll() is not None:
            raise _failure(page.returncode, said)
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
            if probe.connect_ex((HOST, web_port)) == 0:
                return
        time.sleep(0.1)
    raise UserError(f"rerun's page did not come up on port {web_port} within {START_S:g} s.")


def program() -> str:
    """Returns the path of the viewer. The script that pip installs forwards neither signals nor exit codes."""
    folder = Path(rerun_cli.__file__).parent
    for name in PROGRAMS:
        if (folder / name).is_file():
            return str(folder / name)
    raise UserError(missing("a window or a page of rerun", "rerun_cli"))


def _failure(code: int, said: IO[str]) -> UserError:
    """Returns the reason why the viewer ended, from its error output."""
    said.seek(0)
    text = said.read()
    if any(word in text.lower() for word in ("graphics driver", "adapter", "render context")):
        return UserError(
            "rerun finds no graphics driver it can draw with; install one for Vulkan (on Debian: mesa-vulkan-drivers), "
            "look from a browser with --web, or make a video with `humoslope video`."
        )
    last = text.strip().splitlines()[-1].strip().rstrip(".") if text.strip() else "without a message"
    return UserError(f"rerun's viewer ended with code {code}: {last}.")
