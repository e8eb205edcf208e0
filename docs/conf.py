"""Configuration of Sphinx, and the parts of the reference that are made from the code: commands, modules, figures."""

from __future__ import annotations

import dataclasses
import io
import os
import re
import sys
from contextlib import redirect_stdout, suppress
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "src")]

import humoslope  # noqa: E402 - after its place is known
from humoslope.cli import EXIT_CODES, VERBS, main  # noqa: E402

project = "HumoSlope"
author = "The HumoSlope maintainers"
copyright = "the HumoSlope maintainers, Apache License 2.0"
release = version = humoslope.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
exclude_patterns = ["_build"]
myst_enable_extensions = ["dollarmath", "amsmath", "deflist"]
myst_heading_anchors = 3
html_theme = "sphinx_book_theme"
html_title = "HumoSlope"
html_theme_options = {"show_toc_level": 2, "use_download_button": False, "use_fullscreen_button": False}

default_role = "code"  # docstrings write `name` for code
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True  # names, not what they are on the machine that builds
autodoc_typehints = "signature"
napoleon_use_ivar = True
suppress_warnings = ["ref.python"]  # types in signatures whose name two modules have

TASK = "HumoSlope-Stage1-Unitree-G1"
WITH_TASK = ("train", "bench", "check")
"""Verbs that have the fields of a task as options; they are printed for the first one."""


def commands() -> str:
    """Markdown with what `--help` prints, for every verb."""
    os.environ["COLUMNS"] = "100"
    sections = [f"{EXIT_CODES.replace(chr(10), ' ')}\n"]
    for verb, line in VERBS.items():
        shown = ["humoslope", verb, *([TASK, "--preset", "cpu"] if verb in WITH_TASK else []), "--help"]
        printed, fields = _help(shown[1:]), ""
        if verb in WITH_TASK and verb != WITH_TASK[0]:
            printed, _, fields = printed.partition("╭─ env options")
        more = f"Every field of the task is an option too, as with `{WITH_TASK[0]}`.\n" if fields else ""
        said = f"```text\n$ {' '.join(shown)}\n{printed.strip()}\n```\n"
        sections.append(f"## {verb}\n\n{line}\n\n{said}\n{more}")
    return "\n".join(sections)


def _help(arguments: list[str]) -> str:
    out = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    with redirect_stdout(out), suppress(SystemExit):
        main(arguments)
    out.seek(0)
    return "\n".join(line.rstrip() for line in out.read().splitlines()).strip()


def modules(name: str) -> str:
    """Markdown with the documentation of a module, or of every module below a package."""
    return "\n".join(
        f"## {one}\n\n```{{eval-rst}}\n.. automodule:: {one}\n   :members:\n   :show-inheritance:\n```\n"
        for one in _below(import_module(name))
    )


def _below(module: ModuleType) -> list[str]:
    """Names of a module that has documentation to show and of those below it."""
    inside = [
        name
        for found in sorted(iter_modules(getattr(module, "__path__", [])), key=lambda found: found.name)
        for name in _below(import_module(f"{module.__name__}.{found.name}"))
    ]
    return inside or [module.__name__]


MADE = {r"<!-- commands -->": lambda match: commands(), r"<!-- modules ([\w.]+) -->": lambda match: modules(match[1])}
"""Marks in the pages, and what stands there when they are built."""


def fill(app: Sphinx, page: str, source: list[str]) -> None:
    """Puts what is made from the code in place of its marks."""
    for mark, make in MADE.items():
        source[0] = re.sub(mark, make, source[0])


def escape(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Keeps characters of plain docstrings from being read as markup, and lists in columns as they are."""
    paragraphs = "\n".join(lines).split("\n\n")
    if what == "module":
        paragraphs = [_as_it_is(text) if re.search(r"\S {2,}\S", text) else text for text in paragraphs]
    lines[:] = [
        "".join(
            part if part.startswith("`") else re.sub(r"(?<=\w)_(?!\w)", r"\\_", re.sub(r"([*|])", r"\\\1", part))
            for part in re.split(r"(`[^`]*`)", line)
        )
        for line in "\n\n".join(paragraphs).split("\n")
    ]
    if what in ("attribute", "data", "property"):
        lines.insert(0, "")  # on the first line napoleon would take what stands before a colon for a type


def _as_it_is(text: str) -> str:
    return "::\n\n" + "\n".join(f"    {line}" for line in text.split("\n"))


def shorten(
    app: Sphinx, what: str, name: str, thing: object, options: object, signature: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """Leaves ranges out of signatures, and the signatures of dataclasses, whose fields are listed below them."""
    if what == "class" and dataclasses.is_dataclass(thing):
        return "", None
    return signature and _without_metadata(signature), returns and _without_metadata(returns)


def _without_metadata(signature: str) -> str:
    """`Annotated[X, ...]` as X."""
    begin = "Annotated["
    while begin in signature:
        start = signature.index(begin)
        depth, first, place = 0, 0, start + len(begin)
        while depth or signature[place] != "]":
            depth += (signature[place] in "[(") - (signature[place] in "])")
            if not first and not depth and signature[place] == ",":
                first = place
            place += 1
        signature = signature[:start] + signature[start + len(begin) : first] + signature[place + 1 :]
    return signature


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-signature", shorten)
    app.connect("source-read", fill)
    app.connect("autodoc-process-docstring", escape, priority=400)  # before napoleon
