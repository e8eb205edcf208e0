"""Every Python snippet of the pages runs, and every command in them is one that the command line takes."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from functools import cache, wraps
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import tyro

from humoslope import registry
from humoslope.cli import VERBS
from humoslope.learning import networks
from humoslope.terrain import registry as terrains

ROOT = Path(__file__).parents[2]
INCLUDED = ("contributing", "changelog", "experiments", "log")
"""Pages that show a file from elsewhere."""
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md")),
    *sorted(path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts and path.stem not in INCLUDED),
]
ELSEWHERE = ("git", "cp", "mkdir", "pip", "ping", "ip", "uv")
"""Programs that are not ours."""


class Block(NamedTuple):
    """A fenced block of a page."""

    line: int
    language: str
    text: str


@cache
def blocks(page: Path) -> list[Block]:
    """Fenced blocks, and indented ones, which are commands."""
    found, lines, fence, start = [], page.read_text(encoding="utf-8").splitlines(), "", 0
    for number, line in enumerate(lines, start=1):
        if match := re.match(r"```(\S*)$", line):
            if fence:
                found.append(Block(start + 1, fence, "\n".join(lines[start : number - 1])))
            fence, start = ("" if fence else match[1] or "text"), number
        elif not fence and re.match(r" {4}\S", line) and not lines[number - 2].lstrip().startswith(("-", "|", ":")):
            found.append(Block(number, "bash", line.strip()))
    assert not fence, f"{page}: the block of line {start} is not closed"
    return found


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


# Python


@pytest.fixture
def _registries(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What a page registers is forgotten after it, and what it writes lies in a folder of its own."""
    monkeypatch.setattr(registry, "_tasks", dict(registry._tasks))
    monkeypatch.setattr(terrains, "_REGISTRY", dict(terrains._REGISTRY))
    monkeypatch.setattr(networks, "_NETWORKS", dict(networks._NETWORKS))
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("_registries")
@pytest.mark.parametrize("page", [p for p in PAGES if any(b.language == "python" for b in blocks(p))], ids=name_of)
def test_the_python_of_a_page_runs_from_top_to_bottom(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Dataclasses look their module up by its name.
    module = type(sys)("page")
    monkeypatch.setitem(sys.modules, "page", module)
    for block in blocks(page):
        if block.language == "python":
            # With the lines of the page, so that a traceback leads there.
            code = compile("\n" * (block.line - 1) + block.text, str(page), "exec")
            exec(code, module.__dict__)


# Commands


def commands() -> list[tuple[str, str]]:
    """Every command with the page that shows it first."""
    found: dict[str, str] = {}
    for page in PAGES:
        for block in blocks(page):
            if block.language == "bash":
                for line in block.text.replace("\\\n", " ").splitlines():
                    if words := shlex.split(line, comments=True):
                        found.setdefault(shlex.join(words), name_of(page))
    return list(found.items())


class Parsed(Exception):
    """The arguments were understood, and nothing was done."""


def parsing(cli: Callable[..., Any]) -> Callable[..., Any]:
    """`tyro.cli` that ends a verb as soon as its last options are parsed."""

    def parse(thing: Any, *args: Any, **kwargs: Any) -> Any:
        if kwargs.get("return_unknown_args"):
            return cli(thing, *args, **kwargs)
        if not isinstance(thing, type) and callable(thing) and hasattr(thing, "__code__"):
            thing = _without_work(thing)
        cli(thing, *args, **kwargs)
        raise Parsed

    return parse


def _without_work(function: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(function)
    def nothing(*args: Any, **kwargs: Any) -> None:
        pass

    return nothing


def check_humoslope(arguments: list[str]) -> None:
    """Lets the verb parse its arguments, and do nothing else."""
    verb, rest = arguments[0], arguments[1:]
    if verb in ("-h", "--help"):
        return
    assert verb in VERBS, f"there is no verb {verb}"
    if "--resume" in rest:  # of a run that a reader has
        place = rest.index("--resume")
        rest = rest[:place] + rest[place + 2 :]
    with pytest.raises((Parsed, SystemExit)) as ended:
        import_module(f"humoslope.cli.{verb}").run(rest)
    assert ended.type is Parsed or ended.value.code == 0, arguments


def check_make(words: list[str]) -> None:
    """Asks make what it would do, and looks at that."""
    done = subprocess.run(
        ["make", "-n", "-o", ".venv/.installed", "-o", ".venv/.docs", *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    for line in done.stdout.replace("\\\n", " ").splitlines():
        if line.startswith(".venv/bin/humoslope "):
            check_humoslope(shlex.split(line)[1:])


@pytest.mark.parametrize(("command", "page"), commands(), ids=lambda value: value)
def test_a_command_of_a_page_is_understood(command: str, page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tyro, "cli", parsing(tyro.cli))
    # Stage II starts from the shipped checkpoint, whatever has been trained in this checkout.
    monkeypatch.setattr("humoslope.cli.warm_start.runs_of", lambda task: [])
    words = shlex.split(command)
    while "=" in words[0]:
        words.pop(0)
    for word in words:
        if word.startswith(("experiments/", "tests/")) and ".export" not in word:
            assert (ROOT / word).exists(), f"{page}: there is no {word}"
    program, rest = Path(words[0]).name, words[1:]
    if program == "make":
        if rest[:1] != ["reproduce"]:  # a make of its own
            check_make(rest)
    elif program == "humoslope":
        check_humoslope(rest)
    elif "-m" in rest and rest[rest.index("-m") + 1] == "humoslope":
        check_humoslope(rest[rest.index("-m") + 2 :])
    elif words[0].startswith(".venv/bin/") and program != "pip":
        assert (Path(sys.executable).parent / program).exists(), f"{page}: there is no {program}"
    else:
        assert program in ELSEWHERE, f"{page}: what is {program}?"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_verbs_and_targets_in_sentences_exist(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    targets = re.findall(r"^([a-z0-9-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for program, word in re.findall(r"`(?:\.venv/bin/)?(make|humoslope) (?:-n )?([a-z0-9-]+)", text):
        assert word in (targets if program == "make" else VERBS), f"{program} {word}"
