"""Writing of files so that a crash never leaves half of one, and of folders that do not outlive their process."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from humoslope.errors import UserError

TEMPORARY = re.compile(r"\.(?P<name>.+)\.[a-z0-9_]{8}(?P<suffix>(\.[^.]*)?)")
"""Names of temporary files: that of the file, random characters, and its ending again, which libraries go by."""
FOLDER_PREFIX = ".humoslope-tmp-"
"""How the names of temporary folders begin."""
TEMPORARY_FOLDER = re.compile(re.escape(FOLDER_PREFIX) + r"[a-z0-9_]{8}")


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Writes a file in one step: `write` fills a temporary file beside it, which then replaces it.

    What a process that was killed has left of the same file is removed.

    Raises:
        UserError: If it cannot be written, as on a full disk; a file that was there before is whole.
    """
    made: list[Path] = []
    try:
        made += [folder for folder in path.parents if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(path.parent, path.name)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix)
        temporary = Path(name)
    except OSError as error:
        raise _unwritten(path, error) from None
    except BaseException:  # a signal while the file was being made, the name of which is lost
        remove_leftovers(path.parent, path.name)
        raise
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        write(temporary)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
        _fsync(path.parent)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        for folder in made:
            with suppress(OSError):  # it is not empty any more
                folder.rmdir()
        if isinstance(error, OSError) or _is_of_the_system(error):
            raise _unwritten(path, error) from error
        raise
    finally:
        os.close(handle)


def remove_leftovers(folder: Path, name: str = "") -> None:
    """Removes temporary files of `write_atomically` in a folder whose process is dead: its lock on them ended with it.

    Args:
        name: Name of the file that they were for; "" for any.
    """
    for path in folder.glob(".*"):
        found = TEMPORARY.fullmatch(path.name)
        if found is None or Path(found["name"]).suffix != found["suffix"] or name not in ("", found["name"]):
            continue
        if path.is_file() and _is_free(path):
            path.unlink(missing_ok=True)


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder that is removed at the end, or at the next call of this function if the process was killed."""
    for left in Path(tempfile.gettempdir()).glob(f"{FOLDER_PREFIX}*"):
        if TEMPORARY_FOLDER.fullmatch(left.name) and left.is_dir() and _is_free(left):
            shutil.rmtree(left, ignore_errors=True)
    folder, handle = _locked_folder()
    try:
        yield folder
    finally:
        os.close(handle)
        shutil.rmtree(folder, ignore_errors=True)


def _locked_folder() -> tuple[Path, int]:
    """A new temporary folder, and the handle that holds its lock."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=FOLDER_PREFIX))
        try:
            handle = os.open(folder, os.O_RDONLY)
        except FileNotFoundError:
            continue  # another process took it for a leftover before it was locked
        fcntl.flock(handle, fcntl.LOCK_EX)
        if folder.exists():
            return folder, handle
        os.close(handle)


def check_place(path: Path) -> None:
    """Checks, before the work whose result it is for, that a file can be written; creates nothing.

    Raises:
        UserError: If `path` is a folder, or its folder can neither be created nor written to.
    """
    try:
        if path.is_dir():
            raise UserError(f"'{path}' is a folder; name a file in it.")
        existing = next(p for p in path.absolute().parents if p.exists())
    except OSError as error:
        raise _unwritten(path, error) from None
    if not existing.is_dir() or not os.access(existing, os.W_OK):
        raise UserError(f"cannot write '{path}': '{existing}' is no folder one can write to.")


def read_bytes(kind: str, path: Path) -> bytes:
    """The content of a file.

    Args:
        kind: Kind of file, for the message.

    Raises:
        UserError: If it does not exist, is no file or cannot be read.
    """
    try:
        if not path.is_file():
            raise UserError(f"{kind} '{path}' does not exist.")
        return path.read_bytes()
    except OSError as error:
        raise UserError(f"{kind} '{path}' cannot be read: {error.strerror}.") from None


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Writes a file in one step."""
    write_atomically(path, lambda temporary: temporary.write_bytes(content))


def write_text(path: Path, text: str) -> None:
    """Writes a text file in one step."""
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _fsync(folder: Path) -> None:
    """Puts the names in a folder on the disk, or a power cut could bring back the file that was there before."""
    with suppress(OSError):  # not every file system can
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def is_locked(path: Path) -> bool:
    """True if a process holds the lock on a file or folder.

    Raises:
        OSError: If it cannot be opened.
    """
    handle = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(handle)
    return False


def _is_free(path: Path) -> bool:
    """True if no process holds the lock on a file or folder of this user."""
    try:
        return not is_locked(path)
    except OSError:
        return False


def _is_of_the_system(error: BaseException) -> bool:
    """True for what libraries that are not written in Python make of the operating system's errors."""
    return isinstance(error, RuntimeError) and "os error" in str(error)


def _unwritten(path: Path, error: BaseException) -> UserError:
    if isinstance(error, FileExistsError):  # by `mkdir`, whose "File exists" would be taken for `path` itself
        reason = f"'{error.filename}' is a file, not a folder"
    else:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[-1]
    kept = "; the file that was there is whole" if _exists(path) else ""
    return UserError(f"cannot write '{path}': {reason}{kept}.")


def _exists(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:
        return False
