"""A package index on this machine, and packages for it."""

from __future__ import annotations

import io
import os
import threading
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest


def toy_wheel(files: Mapping[str, bytes | str]) -> bytes:
    """A package `toys` 1.0 with these files."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, text in files.items():
            archive.writestr(zipfile.ZipInfo(name), text)  # the same bytes at any time
        for name, text in (
            ("METADATA", "Metadata-Version: 2.1\nName: toys\nVersion: 1.0\n"),
            ("WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n"),
            ("RECORD", ""),
        ):
            archive.writestr(zipfile.ZipInfo(f"toys-1.0.dist-info/{name}"), text)
    return content.getvalue()


@contextmanager
def index_of(wheel: bytes, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The address of an index that has the package `toys` and nothing else; pip knows no other."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:
            pass

    home = folder / "index" / "toys"
    home.mkdir(parents=True)
    (home / "toys-1.0-py3-none-any.whl").write_bytes(wheel)
    (home / "index.html").write_text('<a href="toys-1.0-py3-none-any.whl">toys-1.0-py3-none-any.whl</a>')
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder / "index")))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    for name in ("PIP_FIND_LINKS", "PIP_EXTRA_INDEX_URL", "PIP_NO_INDEX"):
        monkeypatch.delenv(name, raising=False)
    address = f"http://127.0.0.1:{server.server_port}"
    for name, value in (("CONFIG_FILE", os.devnull), ("INDEX_URL", address), ("RETRIES", "0"), ("NO_CACHE_DIR", "1")):
        monkeypatch.setenv(f"PIP_{name}", value)
    yield address
    server.shutdown()
    server.server_close()
