"""Seals: files that know when they are damaged.

A zip archive (a checkpoint, a rollout, saved trials) carries the SHA-256 of everything before it as its comment; a JSON
file (results, calibrations) carries it as its last entry. The files of a folder (an export, the record of a start,
meshes) are listed with theirs in `SHA256SUMS`, and a table in a file beside it, in the format of `sha256sum`. Files of
earlier versions have no seal, and are read without one.

All results are sealed, also those that no verb reads again. Not sealed is what is only looked at (figures, films,
tables for documents, console.log) or has checksums of its own (event files).
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humoslope.errors import UserError
from humoslope.files import write_atomically, write_text

MARK = b"humoslope sha256 "
END_OF_ARCHIVE = b"PK\x05\x06"
END_SIZE = 22
"""Length of a zip archive's last record without its comment, bytes; the last two hold the comment's length."""
LAST_ENTRY = b',\n  "sha256": "'
END = b'"\n}\n'
SUMS = "SHA256SUMS"


def seal(archive: io.BytesIO) -> None:
    """Gives a zip archive without comment the SHA-256 of its bytes as comment, in place: archives may be large."""
    with archive.getbuffer() as content:
        assert content[-END_SIZE : -END_SIZE + 4] == END_OF_ARCHIVE
    archive.seek(-2, io.SEEK_END)
    archive.write((len(MARK) + 64).to_bytes(2, "little") + MARK)
    with archive.getbuffer() as content:
        digest = hashlib.sha256(content).hexdigest()
    archive.write(digest.encode())


def sealed(archive: bytes) -> bytes:
    """A zip archive without comment, with the SHA-256 of its bytes as comment."""
    buffer = io.BytesIO(archive)
    seal(buffer)
    return buffer.getvalue()


def is_sealed(content: bytes) -> bool:
    """True if the SHA-256 at the end of a file is that of the bytes before it."""
    body, digest = content[:-64], content[-64:]
    return body.endswith(MARK) and hashlib.sha256(body).hexdigest().encode() == digest


def is_without_seal(content: bytes) -> bool:
    """True for a zip archive that ends where one without a comment does: it was never sealed."""
    return content[-END_SIZE : -END_SIZE + 4] == END_OF_ARCHIVE and content[-2:] == b"\0\0"


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Writes a sealed NumPy archive in one step."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    seal(buffer)
    write_atomically(path, lambda temporary: temporary.write_bytes(buffer.getbuffer()))


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a NumPy archive; nothing in it is executed.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is damaged; whatever zip archives raise then, if it has no seal.
    """
    content = path.read_bytes()
    if not is_sealed(content) and not is_without_seal(content):
        raise ValueError("its checksum does not fit")
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        return dict(archive)


def sealed_json(report: Mapping[str, Any]) -> str:
    """A report as JSON, with the SHA-256 of what stands before it as last entry.

    Raises:
        ValueError: If a number is not finite.
    """
    body = json.dumps({**report}, indent=2, allow_nan=False).encode().removesuffix(b"\n}") + LAST_ENTRY
    digest = hashlib.sha256(body).hexdigest()
    return f'{body.decode()}{digest}"\n}}\n'


def finite(value: Any) -> Any:
    """A report of what was measured, in which numbers that are not finite, such as those of a simulation that has
    diverged, are None: JSON has no others."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_json(path: Path, report: Mapping[str, Any]) -> None:
    """Writes a sealed JSON file in one step; see `sealed_json`."""
    write_text(path, sealed_json(report))


def read_json(path: Path) -> Any:
    """The content of a JSON file, without its seal.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is damaged or no JSON.
    """
    content = path.read_bytes()
    body, _, tail = content.rpartition(LAST_ENTRY)
    if body and tail == hashlib.sha256(body + LAST_ENTRY).hexdigest().encode() + END:
        read = json.loads(body + b"\n}")
    elif _had_seal(content) or _had_seal(content + b"\n"):  # the last line may have lost its end
        raise ValueError("its checksum does not fit")
    else:
        read = json.loads(content)
    if isinstance(read, list | dict) and not _is_shallow(read):
        raise ValueError("it is nested too deeply")
    return read


def beside(path: Path) -> str:
    """Name of the list with the SHA-256 of a single file, which lies beside it."""
    return f"{path.name}.sha256"


def write_sums(folder: Path, files: Iterable[str], name: str = SUMS) -> None:
    """Lists files of a folder with their SHA-256, below a comment with their number, so that no line can be lost."""
    lines = [f"{hashlib.sha256((folder / file).read_bytes()).hexdigest()}  {file}\n" for file in sorted(files)]
    write_text(folder / name, f"# files: {len(lines)}\n{''.join(lines)}")


def check_sums(folder: Path, advice: str = "export anew, or", name: str = SUMS) -> None:
    """Compares the files of a folder with their list; a folder without a list passes.

    Args:
        advice: What to do, for the message, which goes on with ", if a change is meant, remove" the list.
        name: Name of the list.

    Raises:
        UserError: If a file is missing or another one than was listed, or the list itself is damaged.
    """
    path = folder / name
    if not path.exists():
        return
    again = f"{advice}, if a change is meant, remove '{path}'"
    try:
        lines = path.read_bytes().decode("ascii").splitlines(keepends=True)
    except (OSError, UnicodeDecodeError):
        lines = []
    number = re.fullmatch(r"# files: (\d+)\n", lines[0]) if lines else None
    if number is not None:  # lists of earlier versions do not have it
        lines = lines[1:]
    listed = [re.fullmatch(r"([0-9a-f]{64})  ([!-~]+)\n", line) for line in lines]
    if not listed or None in listed or (number is not None and int(number[1]) != len(listed)):
        raise UserError(f"'{path}' is damaged; {again}.")
    for entry in listed:
        assert entry is not None
        digest, file = entry.groups()
        try:
            found = hashlib.sha256((folder / file).read_bytes()).hexdigest() if _is_inside(file) else ""
        except OSError:
            raise UserError(f"'{folder / file}', which '{path}' lists, cannot be read; {again}.") from None
        if found != digest:
            raise UserError(f"'{folder / file}' is damaged or was changed since it was written; {again}.")


def _had_seal(content: bytes) -> bool:
    """True for a file with most of a seal at its end, of which some bits have changed."""
    tail = content[-len(LAST_ENTRY) - 64 - len(END) :]
    pairs = zip(LAST_ENTRY + END, tail[: len(LAST_ENTRY)] + tail[-len(END) :], strict=False)
    return 2 * sum(a == b for a, b in pairs) > len(LAST_ENTRY + END)


def _is_inside(file: str) -> bool:
    return not Path(file).is_absolute() and ".." not in Path(file).parts


def _is_shallow(value: Any, depth: int = 100) -> bool:
    """True if a JSON value is not nested deeper than anything that is written here."""
    items = list(value.values()) if isinstance(value, dict) else value if isinstance(value, list) else []
    return depth > 0 and all(_is_shallow(item, depth - 1) for item in items)
