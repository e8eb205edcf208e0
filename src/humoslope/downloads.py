"""Files of Python packages: downloaded from the package index, and verified by hash."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from humoslope.errors import UserError
from humoslope.files import temporary_folder
from humoslope.interrupts import die_with_parent


@dataclass(frozen=True)
class Wheel:
    """A package of which only some files are wanted.

    Attributes:
        package: Name on the package index.
        version: Version on the package index.
        sha256: Checksum of the wheel, hexadecimal.
        carries: What is wanted of it, for messages, such as "the meshes".
    """

    package: str
    version: str
    sha256: str
    carries: str

    @property
    def title(self) -> str:
        """Name and version."""
        return f"{self.package} {self.version}"


def fetch(wheel: Wheel, names: Iterable[str]) -> dict[str, bytes]:
    """Downloads a wheel with pip and returns files of it by their paths inside; nothing of it is installed or run.

    Raises:
        UserError: If the package is unavailable, has another hash, or lacks a file.
    """
    files = {}
    with temporary_folder() as folder, zipfile.ZipFile(_download(wheel, folder)) as archive:
        for name in names:
            try:
                files[name] = archive.read(name)
            except KeyError:
                raise UserError(f"{wheel.title} has no {name}.") from None
    return files


def _download(wheel: Wheel, folder: Path) -> Path:
    """Returns the downloaded wheel. pip checks the hash, and uses the user's own index, proxy and certificates."""
    wanted = folder / "wanted.txt"
    wanted.write_text(f"{wheel.package}=={wheel.version} --hash=sha256:{wheel.sha256}\n")
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--disable-pip-version-check"]
    options = ["--only-binary", ":all:", "--require-hashes", "--requirement", str(wanted), "--dest", str(folder)]
    words = [*command, *options]
    done = subprocess.run(words, capture_output=True, text=True, check=False, preexec_fn=die_with_parent)
    if done.returncode:
        if "DO NOT MATCH THE HASHES" in done.stderr:
            raise UserError(
                f"the {wheel.title} that was downloaded does not have the SHA-256 {wheel.sha256}; it was not kept."
            )
        if "No module named pip" in done.stderr:
            raise UserError(f"pip is needed to fetch {wheel.title}, and is not installed for {sys.executable}.")
        raise UserError(f"{wheel.title}, which carries {wheel.carries}, could not be downloaded; is there a network?")
    return next(folder.glob("*.whl"))
