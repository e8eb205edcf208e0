"""What the operating system denies is said in one sentence that names it: folders, files, names, file handles."""

from __future__ import annotations

import os
import resource
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from humoslope.cli import main
from humoslope.errors import UserError
from humoslope.learning.run_folder import saved_options

TASK = "HumoSlope-Stage1-Unitree-G1"
NOBODY = 65534
Deny = Callable[..., str]


@pytest.fixture
def place() -> Iterator[Path]:
    """A folder that every user can reach."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


@pytest.fixture
def as_nobody(place: Path) -> Deny:
    """Runs a command in a child of this process that no longer belongs to root, after `limit` was called there; returns
    the one sentence that it says."""

    def run(*arguments: str, limit: Callable[[], object] = lambda: None) -> str:
        child, errors = os.fork(), place / "stderr"
        if child == 0:
            code = 70
            try:
                sys.stderr = errors.open("w")
                if os.getuid() == 0:
                    os.setuid(NOBODY)
                limit()
                code = main(list(arguments))
            finally:
                sys.stderr.flush()
                os._exit(code)
        _, status = os.waitpid(child, 0)
        said = errors.read_text()
        assert os.waitstatus_to_exitcode(status) == 2, said
        assert said.startswith("humoslope: ")
        assert said.count("\n") == 1
        return said

    return run


def test_a_run_in_a_folder_that_one_cannot_write_to_is_not_resumed(as_nobody: Deny, place: Path, untrained) -> None:
    shutil.copy(untrained, place / "model_0.pt")
    place.chmod(0o555)
    said = as_nobody("train", TASK, "--resume", str(place))
    assert f"cannot write '{place}/config.json': '{place}' is no folder one can write to." in said
    assert [path.name for path in place.iterdir() if path.name != "stderr"] == ["model_0.pt"]


@pytest.mark.parametrize("verb", [["ramps"], ["train", TASK, "--init"]], ids=lambda verb: verb[0])
def test_a_checkpoint_that_one_may_not_read_is_not_called_broken(as_nobody: Deny, place: Path, untrained, verb) -> None:
    shutil.copy(untrained, place / "model_0.pt")
    (place / "model_0.pt").chmod(0)
    said = as_nobody(*verb, str(place / "model_0.pt"))
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
def test_a_folder_that_cannot_be_made_is_named(as_nobody: Deny, place: Path, name, said) -> None:
    (place / "file").touch()
    assert said in as_nobody("train", TASK, "--preset", "cpu", "--run-dir", name.format(place=place))


def test_too_few_file_handles_are_said(as_nobody: Deny, place: Path, untrained) -> None:
    shutil.copy(untrained, place / "model_0.pt")
    (place / "model_0.pt").chmod(0o644)

    def few() -> None:
        opened = len(os.listdir("/proc/self/fd"))
        resource.setrlimit(resource.RLIMIT_NOFILE, (opened - 1, opened - 1))

    assert "Too many open files" in as_nobody("ramps", str(place / "model_0.pt"), limit=few)


@pytest.mark.parametrize("content", [b'--env.seed "1', b"--env.seed \xff"], ids=["open quote", "not UTF-8"])
def test_options_that_cannot_be_read_are_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "options.txt").write_bytes(content)
    with pytest.raises(UserError, match="the options in '.*options.txt' cannot be read: "):
        saved_options(tmp_path)
