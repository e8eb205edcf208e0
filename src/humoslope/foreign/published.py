"""Policies that others have published, by name; they are fetched by their hash, and never shipped."""

from __future__ import annotations

from dataclasses import dataclass

from humoslope.downloads import Wheel, fetch


@dataclass(frozen=True)
class PublishedPolicy:
    """A network in a Python package.

    Attributes:
        name: Name for the command line.
        wheel: The package.
        file: Path of the network in it.
        about: How it was trained, a sentence.
        licence: Note on its licence, for the user.
    """

    name: str
    wheel: Wheel
    file: str
    about: str
    licence: str

    def fetch(self) -> bytes:
        """Returns the network, downloaded from the package index.

        Raises:
            UserError: If the package is unavailable, has another hash, or lacks the file.
        """
        return fetch(self.wheel, [self.file])[self.file]
