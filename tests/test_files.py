"""Files are written in one step, and nothing is left of one that was not."""

from __future__ import annotations

import errno
import os
import resource
import signal
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from humoslope.errors import UserError
from humoslope.files import FOLDER_PREFIX, remove_leftovers, temporary_folder, write_atomically, write_bytes, write_text


def test_a_signal_while_the_temporary_file_is_made_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mkstemp = tempfile.mkstemp

    def interrupted(**options: Any) -> None:
        mkstemp(**options)
        assert [path.suffix for path in tmp_path.iterdir()] == [".json"]
        raise KeyboardInterrupt

    monkeypatch.setattr(tempfile, "mkstemp", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_text(tmp_path / "walk.json", "{}")
    assert list(tmp_path.iterdir()) == []


def killed_inside(work: Callable[[], object]) -> None:
    """Kills a child of this process by SIGKILL in the middle of its work, where that calls `hang`."""
    child = os.fork()
    if child == 0:
        try:
            work()
        finally:
            os._exit(70)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == -signal.SIGKILL


def die(*_: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_content_is_on_the_disk_before_its_name_and_then_its_name(tmp_path: Path, monkeypatch) -> None:
    path, synced, own = tmp_path / "walk.json", [], os.fsync

    def fsync(handle: int) -> None:
        name = os.readlink(f"/proc/self/fd/{handle}")
        synced.append((Path(name).is_dir(), path.exists()))
        own(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    write_text(path, "{}")
    assert synced == [(False, False), (True, True)]


def test_what_a_killed_process_leaves_is_removed_when_the_file_is_written_again(tmp_path: Path) -> None:
    path = tmp_path / "walk.json"
    write_text(path, "first")
    killed_inside(lambda: write_atomically(path, die))
    assert len(list(tmp_path.iterdir())) == 2
    assert path.read_text() == "first"
    write_text(path, "second")
    assert list(tmp_path.iterdir()) == [path]
    killed_inside(lambda: write_atomically(path, die))
    remove_leftovers(tmp_path)
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_another_process_is_writing_is_no_leftover(tmp_path: Path) -> None:
    path = tmp_path / "walk.json"

    def write(temporary: Path) -> None:
        remove_leftovers(tmp_path)
        temporary.write_text("whole")

    write_atomically(path, write)
    assert path.read_text() == "whole"


def test_a_folder_of_a_killed_process_is_removed_when_the_next_one_is_made(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def work() -> None:
        with temporary_folder() as folder:
            (folder / "large").write_text("x")
            die()

    killed_inside(work)
    (left,) = tmp_path.glob(f"{FOLDER_PREFIX}*")
    with temporary_folder() as folder:
        assert list(tmp_path.iterdir()) == [folder]
    assert not left.exists()
    assert list(tmp_path.iterdir()) == []


def test_folders_of_others_beside_temporary_ones_stay(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    theirs = {tmp_path / name for name in ("humoslope-main", "humoslope-abcd1234", f"{FOLDER_PREFIX}of-the-user")}
    for folder in theirs:
        folder.mkdir()
    with temporary_folder() as folder:
        assert set(tmp_path.iterdir()) == theirs | {folder}
    assert set(tmp_path.iterdir()) == theirs


@pytest.mark.parametrize("before", [None, b"good"], ids=["new", "replaced"])
def test_a_full_disk_is_said_and_the_file_that_was_there_is_whole(tmp_path: Path, before: bytes | None) -> None:
    path = tmp_path / "deep" / "walk.npz"
    if before is not None:
        path.parent.mkdir()
        path.write_bytes(before)

    def full(temporary: Path) -> None:
        temporary.write_bytes(b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(UserError) as caught:
        write_atomically(path, full)
    kept = "" if before is None else "; the file that was there is whole"
    assert str(caught.value) == f"cannot write '{path}': No space left on device{kept}."
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == ([] if before is None else [path])
    assert before is None or path.read_bytes() == before
    assert path.parent.exists() == (before is not None)


def test_a_file_larger_than_the_system_allows_is_said(tmp_path: Path) -> None:
    """A limit on the size of files, met by a real write."""
    limits, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
        with pytest.raises(UserError, match=r"cannot write '.*a.bin': File too large\."):
            write_bytes(tmp_path / "a.bin", bytes(100_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == []
