"""What does not fit into memory is refused before it is taken, with the size that fits."""

from __future__ import annotations

import re
import resource
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from humoslope import memory
from humoslope.env import EnvCfg
from humoslope.errors import UserError
from humoslope.memory import available, require_memory
from humoslope.terrain.grid import TerrainGridCfg

KIB = 1024


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine with 3,000 KiB and no container; nothing else limits the process."""
    monkeypatch.setattr(memory, "MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(memory, "CGROUPS", ((str(tmp_path), "memory.max", "memory.current", "inactive_file"),))
    monkeypatch.setattr(resource, "getrlimit", lambda which: (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    (tmp_path / "meminfo").write_text("MemTotal:   9000 kB\nMemAvailable:   3000 kB\n")
    return tmp_path


def test_the_least_of_machine_container_and_own_limit_is_available(machine: Path, monkeypatch) -> None:
    assert available() == 3000 * KIB
    (machine / "memory.max").write_text("max\n")
    (machine / "memory.current").write_text(f"{500 * KIB}\n")
    assert available() == 3000 * KIB
    (machine / "memory.max").write_text(f"{2000 * KIB}\n")
    assert available() == 1500 * KIB
    (machine / "memory.stat").write_text(f"anon 7\ninactive_file {100 * KIB}\nactive_file 7\n")
    assert available() == 1600 * KIB  # copies of files give way
    monkeypatch.setattr(memory, "STATM", machine / "statm")
    (machine / "statm").write_text("10 5 1 1 0 5 0\n")
    monkeypatch.setattr(resource, "getrlimit", lambda which: (100 * resource.getpagesize(), 0))
    assert available() == 90 * resource.getpagesize()


def test_a_machine_that_tells_nothing_refuses_nothing(machine: Path) -> None:
    (machine / "meminfo").unlink()
    assert available() is None
    require_memory("it", 10**15, 10**9)


def test_the_size_that_fits_is_said_and_fits(machine: Path) -> None:
    said = r"env.num_envs is 4,000, which needs 0.0 GiB of memory; 0.0 GiB are free, enough for 3,000 with all else\."
    with pytest.raises(UserError, match=said):
        require_memory("env.num_envs", 4000, KIB, " with all else")
    require_memory("env.num_envs", 3000, KIB)


def refused(monkeypatch: pytest.MonkeyPatch, room: int, build: Callable[[], object]) -> str:
    with monkeypatch.context() as patch:
        patch.setattr(memory, "available", lambda: room)
        with pytest.raises(UserError, match="enough for") as caught:
            build()
    return str(caught.value)


def test_a_ground_with_more_heights_than_there_is_room_for_is_refused(monkeypatch) -> None:
    cfg = TerrainGridCfg(columns={"flat": 1.0}, levels=2, num_columns=2)
    said = refused(monkeypatch, 100_000, cfg.build)
    assert said.startswith("the number of heights of the ground is ")
    assert said.endswith("enough for 1,000.")


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda cfg: None, "env.num_envs is 2, "),
        (
            lambda cfg: setattr(cfg.observations.critic, "history", 1000),
            "observation group 'critic'.history is 1,000, ",
        ),
        (lambda cfg: setattr(cfg.sim, "observation_age_s", 0.5), "the number of past readings is 100, "),
    ],
)
def test_what_a_world_remembers_is_refused_where_it_does_not_fit(
    make_stage1, monkeypatch, change: Callable[[EnvCfg], Any], what: str
) -> None:
    """Each in a room that holds all else."""

    def build() -> None:
        def small(cfg: EnvCfg) -> None:
            cfg.scene.terrain = TerrainGridCfg(columns={"hillside": 1.0}, levels=1, num_columns=1, cell=0.5, border=1.0)
            change(cfg)
            monkeypatch.setattr("humoslope.env._bytes_per_env", lambda cfg: 10_000)

        make_stage1(2, small)

    room = 19_999 if what.startswith("env") else 90_000
    said = refused(monkeypatch, room, build)
    assert said.startswith(what)
    fits = int(re.search(r"enough for ([\d,]+)", said)[1].replace(",", ""))  # type: ignore[index]
    assert fits >= 1
