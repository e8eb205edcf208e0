"""`humoslope margins`: from an export alone to a table, a JSON and a figure; interrupted and continued."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from humoslope.deploy.gait import Gait
from humoslope.deploy.player import Trial, TrialCfg
from humoslope.evaluation.margins import run as margins
from humoslope.evaluation.margins import show, trials
from humoslope.evaluation.margins.quantities import Success
from humoslope.evaluation.margins.search import Rule
from humoslope.interrupts import Interrupt

NO_GAIT = Gait(*[math.nan] * 4)
GOOD = Trial(False, 20.0, 9.0, 0.5, 9.0, 0.5, 3.0, 0.0, 0.5, 0.0, Gait(0.0, 0.1, 0.5, 0.05))
TINY = ("--trials", "2", "--share", "0.7", "--confidence", "0.5", "--seconds", "2.5", "--speed-error", "0.4")
CODE = """
import sys
from humoslope.cli import main
assert main(sys.argv[1:]) == 0
print("MODULES", *sys.modules)
"""


def test_a_certificate_is_written_without_torch(exported: Path, tmp_path: Path) -> None:
    out = tmp_path / "certificate"
    options = (*TINY, "--quantities", "load", "timestep-coarse", "--processes", "2", "--out", str(out))
    command = [sys.executable, "-c", CODE, "margins", str(exported), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    printed, modules = done.stdout.split("MODULES")
    assert not {name.partition(".")[0] for name in modules.split()} & {"torch", "tensordict", "mjbatch"}
    report = json.loads((tmp_path / "certificate.json").read_text())
    assert list(report["quantities"]) == ["load", "timestep-coarse"]
    for name, found in report["quantities"].items():
        assert name in printed
        tested = {series["value"]: series["holds"] for series in found["tested"]}
        assert tested.get(found["limit"], found["limit"] == found["grid"][0])
        assert found["first_failing"] is None or not tested[found["first_failing"]]
    assert report["quantities"]["load"]["grid"][0] == 0.0
    assert report["reference"]["successes"] == 2
    assert (tmp_path / "certificate.png").read_bytes().startswith(b"\x89PNG")


def made_up(job: trials.Job) -> Trial:
    """A policy that falls from 20 kg or 55 ms on."""
    return replace(GOOD, fell=job.setup.conditions.load_kg > 19.0 or job.setup.conditions.delay_s > 0.052)


@pytest.fixture
def certify(exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., margins.Certificate]:
    monkeypatch.setattr(trials, "run_job", made_up)

    def make(store: str, trials: int = 64) -> margins.Certificate:
        names, rule = ("load", "delay"), Rule(trials=trials)
        return margins.Certificate(exported, TrialCfg(), names, rule, Success(), None, tmp_path / store)

    return make


def test_known_limits_are_found(certify: Callable[..., margins.Certificate]) -> None:
    certificate = certify("trials.json")
    assert certificate.run(Interrupt(), 1)
    found = certificate.report()["quantities"]
    assert (found["load"]["limit"], found["load"]["first_failing"]) == (18.0, 20.0)
    assert (found["delay"]["limit"], found["delay"]["first_failing"]) == (50.0, 55.0)
    assert all(s["trials"] == (64 if s["holds"] else 16) for f in found.values() for s in f["tested"])


def test_the_first_value_is_not_certified_by_trials_on_another_slope(
    exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A policy that walks up 20 degrees and nothing else."""

    def made_up(job: trials.Job) -> Trial:
        return replace(GOOD, fell=job.setup.cfg.grade != 20.0)

    monkeypatch.setattr(trials, "run_job", made_up)
    nominal, names = TrialCfg(grade=20.0), ("slope-up", "slope-down", "cross-slope", "yaw-rate", "load")
    certificate = margins.Certificate(
        exported, nominal, names, Rule(trials=64), Success(), None, tmp_path / "trials.json"
    )
    assert certificate.run(Interrupt(), 1)
    report = certificate.report()
    for name in names[:-1]:
        found = report["quantities"][name]
        assert (found["limit"], found["first_failing"]) == (None, 0.0)
        assert [series["value"] for series in found["tested"]] == found["grid"][:2]
    assert report["quantities"]["load"]["limit"] == 50.0
    rows = list(zip(*(column.cells for column in show.table(report).columns), strict=True))
    assert rows[0][:7] == ("slope-up", "°", "0", "none", "-", "0", "0/16")
    assert rows[4][3] == "50 (end)"
    show.draw(report, tmp_path / "a.png")


def test_a_certificate_that_was_stopped_again_and_again_ends_as_one_that_was_not(
    certify: Callable[..., margins.Certificate], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = certify("whole.json")
    assert whole.run(Interrupt(), 1)
    trials_run, calls = 0, 0

    def counted(job: trials.Job) -> Trial:
        nonlocal trials_run
        trials_run += 1
        return made_up(job)

    monkeypatch.setattr(trials, "run_job", counted)
    finished = False
    while not finished:
        calls += 1
        part, interrupt = certify("parts.json"), Interrupt()
        before = len(part.store)

        def stop(done: int, left: int, interrupt: Interrupt = interrupt, before: int = before) -> None:
            interrupt.number = signal.SIGINT if done >= before + 100 else 0

        finished = part.run(interrupt, 1, stop)
    assert calls > 3
    assert trials_run == len(whole.store)  # none was run twice
    assert part.report() == whole.report()


def test_a_trial_that_ended_early_is_kept_without_its_numbers(tmp_path: Path) -> None:
    path, early = tmp_path / "trials.json", Trial(True, 1.0, 0.2, *[math.nan] * 7, NO_GAIT)
    store = trials.TrialStore(path, "these")
    store.add(("load", 4.0, 0), early)
    store.save()
    assert "NaN" not in path.read_text()
    assert repr(trials.TrialStore(path, "these").get(("load", 4.0, 0))) == repr(early)


def test_a_damaged_or_foreign_file_of_trials_is_not_used(
    certify: Callable[..., margins.Certificate], tmp_path: Path
) -> None:
    certificate = certify("trials.json")
    assert certificate.run(Interrupt(), 1)
    path = tmp_path / "trials.json"
    assert len(certify("trials.json").store) == len(certificate.store)
    raw: dict[str, Any] = json.loads(path.read_text())
    path.write_text(json.dumps(raw | {"fingerprint": "other"}))
    assert len(certify("trials.json").store) == 0
    path.write_text(path.read_text()[:1000])
    assert len(certify("trials.json").store) == 0


def test_mistakes_are_said_in_one_sentence(
    mistake: Callable[..., str], exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "at least 59 are needed" in mistake("margins", str(exported), "--trials", "10")
    assert "margins: speed is 0; it must be positive" in mistake("margins", str(exported), "--speed", "0")
    assert "when the first push comes" in mistake("margins", str(exported), "--seconds", "4")
    assert "'no.xml' does not exist" in mistake("margins", str(exported), "--model", "no.xml")
    assert "holds no policy.json" in mistake("margins", str(tmp_path))
    monkeypatch.setattr(trials, "run_job", lambda job: Trial(True, 1.0, 0.2, *[math.nan] * 7, NO_GAIT))
    said = mistake("margins", str(exported), "--processes", "1", "--out", str(tmp_path / "out"))
    assert "succeeds in 0 of 16 trials under nominal conditions, and falls in 16; there is no margin to certify" in said
    assert not (tmp_path / "out.json").exists()
