"""A run folder belongs to one training at a time, and is left as it was found if nothing comes of it."""

from __future__ import annotations

import subprocess
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from humoslope.errors import UserError
from humoslope.learning import run_folder
from humoslope.learning.run_folder import claimed, find_run, record_start, runs_of, saved_options, tee
from humoslope.registry import build_task
from humoslope.seal import SUMS

HOLD = """
import sys
from pathlib import Path
from humoslope.learning.run_folder import claimed
with claimed(Path(sys.argv[1]), "Walk", new=True):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_folder_that_another_process_holds_is_refused_and_freed_however_that_ends(tmp_path: Path) -> None:
    path = tmp_path / "run"
    child = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == "held\n"
        for new in (True, False):
            with pytest.raises(UserError, match="is in use by another training"), claimed(path, "Walk", new):
                pass
    finally:
        child.kill()
        child.communicate()
    with claimed(path, "Walk", new=True) as claim:
        assert claim == path


def test_a_folder_that_nothing_was_written_into_is_removed_with_its_parents(tmp_path: Path) -> None:
    with claimed(tmp_path / "a" / "b" / "run", "Walk", new=True):
        pass
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(RuntimeError, match="later"), claimed(tmp_path / "run", "Walk", new=True):
        raise RuntimeError("later")
    assert list(tmp_path.iterdir()) == []


def test_what_was_written_and_what_was_there_before_stays(tmp_path: Path) -> None:
    with claimed(tmp_path / "run", "Walk", new=True) as path:
        (path / "model_0.pt").touch()
    assert (tmp_path / "run" / "model_0.pt").is_file()
    (tmp_path / "empty").mkdir()
    with claimed(tmp_path / "empty", "Walk", new=True):
        pass
    assert (tmp_path / "empty").is_dir()


def test_two_runs_that_start_in_the_same_second_have_two_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stopped(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> Stopped:
            return cls(2026, 1, 2, 3, 4, 5)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run_folder, "datetime", Stopped)
    with claimed(None, "Walk", new=True) as first, claimed(None, "Walk", new=True) as second:
        assert first == Path("logs/Walk/2026-01-02_03-04-05")
        assert second == Path("logs/Walk/2026-01-02_03-04-05_2")
    assert list(tmp_path.iterdir()) == []


def test_a_record_of_a_start_that_was_changed_is_not_believed(tmp_path):
    cfg = build_task("HumoSlope-Stage1-Unitree-G1")
    record_start(tmp_path, "task", cfg, ["--env.seed", "1"], 0, 0, None)
    assert saved_options(tmp_path) == ["--env.seed", "1"]
    (tmp_path / "starts" / "1" / "options.txt").write_text("--env.seed 2")
    with pytest.raises(UserError, match=r"options.txt' is damaged or was changed .*; or, if a change is meant, remove"):
        saved_options(tmp_path)
    (tmp_path / "starts" / "1" / SUMS).unlink()
    assert saved_options(tmp_path) == ["--env.seed", "2"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux alone has a file on which no room is left")
def test_a_full_disk_takes_the_text_on_the_terminal_nowhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "console.log").symlink_to("/dev/full")
    with tee(tmp_path / "console.log") as console:
        console.print("first")
        console.print("second")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("console.log cannot be written (No space left on device); training goes on without it.")
    assert lines[1:] == ["first", "second"]


def test_a_checkpoint_in_place_of_a_run_folder_is_told_what_takes_it(tmp_path: Path) -> None:
    (tmp_path / "model_3.pt").touch()
    with pytest.raises(UserError, match=r"model_3.pt' is a file; --resume takes the folder .* with --init\.$"):
        find_run("Walk", str(tmp_path / "model_3.pt"))


def test_runs_of_a_task_are_found_where_run_dir_put_them_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Clock(datetime):
        second = 0

        @classmethod
        def now(cls, tz: Any = None) -> Clock:
            cls.second += 1
            return cls(2026, 1, 2, 3, 4, cls.second)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run_folder, "datetime", Clock)
    cfg = build_task("HumoSlope-Stage1-Unitree-G1")
    for name, task in (("logs/second", "A"), ("logs/A/first", "A"), ("logs/other", "B"), ("logs/A/no-checkpoint", "A")):
        record_start(Path(name), task, cfg, [], 0, 0, None)
        if "no" not in name:
            Path(name, "model_1.pt").touch()
    assert runs_of("A") == [Path("logs/second"), Path("logs/A/first")]
    assert find_run("B", "latest") == Path("logs/other")
    with pytest.raises(UserError, match=r"no run of C with a checkpoint under logs\."):
        find_run("C", "latest")
