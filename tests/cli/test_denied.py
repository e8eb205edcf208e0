"""What the operating system denies is said in one sentence that names it: folders, files, names, file handles."""

from __future__ import annotations

import os
import resource
import shutil
import tempfile
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

from humoslope.errors import UserError
from humoslope.learning.run_folder import saved_options
from humoslope.registry import load_content
from tests import processes

TASK = "HumoSlope-Stage1-Unitree-G1"
NOBODY = 65534


@pytest.fixture
def place() -> Iterator[Path]:
    """A folder that every user can reach."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


def become_nobody() -> None:
    # Python itself may lie where only root can read.
    import_module("humoslope.cli.train")
    load_content()
    if os.getuid() == 0:
        os.setuid(NOBODY)


def test_a_run_in_a_folder_that_one_cannot_write_to_is_not_resumed(place: Path, untrained: Path) -> None:
    shutil.copy(untrained, place / "model_0.pt")
    (place / "model_0.pt").chmod(0o644)
    place.chmod(0o555)
    done = processes.start("train", TASK, "--resume", str(place), prepare=become_nobody).wait()
    said = f"humoslope: cannot write '{place}/config.json': '{place}' is no folder one can write to.\n"
    assert (done.returncode, done.stderr) == (2, said)
    assert [path.name for path in place.iterdir()] == ["model_0.pt"]


@pytest.fixture
def nobody() -> Iterator[None]:
    """What is done meanwhile is done without root's rights to read everything."""
    if (was := os.geteuid()) == 0:
        os.seteuid(NOBODY)
    yield
    os.seteuid(was)


@pytest.mark.parametrize("verb", [["ramps"], ["train", TASK, "--init"]], ids=lambda verb: verb[0])
def test_a_checkpoint_that_one_may_not_read_is_not_called_broken(mistake, place: Path, untrained: Path, verb, request):
    shutil.copy(untrained, place / "model_0.pt")
    (place / "model_0.pt").chmod(0)
    request.getfixturevalue("nobody")
    said = mistake(*verb, str(place / "model_0.pt"))
    assert f"checkpoint '{place}/model_0.pt' cannot be read: Permission denied." in said


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("/proc/new", "'/proc"),
        ("{place}/" + "n" * 300, "File name too long"),
        ("{place}/file/run", "is no folder one can write to"),
    ],
    ids=["proc", "long", "file"],
)
def test_a_folder_that_cannot_be_made_is_named(mistake, place: Path, name: str, said: str) -> None:
    (place / "file").touch()
    assert said in mistake("train", TASK, "--preset", "cpu", "--run-dir", name.format(place=place))


def test_too_few_file_handles_are_said(mistake, place: Path, untrained: Path) -> None:
    shutil.copy(untrained, place / "model_0.pt")
    assert "is a folder" in mistake("ramps", str(place / "model_0.pt"), "--out", str(place))  # all is imported
    limits, lowest = resource.getrlimit(resource.RLIMIT_NOFILE), os.dup(0)
    os.close(lowest)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (lowest, limits[1]))
        said = mistake("ramps", str(place / "model_0.pt"))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert "Too many open files" in said


@pytest.mark.parametrize("content", [b'--env.seed "1', b"--env.seed \xff"], ids=["open quote", "not UTF-8"])
def test_options_that_cannot_be_read_are_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "options.txt").write_bytes(content)
    with pytest.raises(UserError, match="the options in '.*options.txt' cannot be read: "):
        saved_options(tmp_path)
