"""The benchmark's table and file say what was measured."""

from __future__ import annotations

import dataclasses
import multiprocessing
import signal
from concurrent.futures import Future

import pytest

from humoslope.cli import bench, main
from humoslope.interrupts import Terminated
from humoslope.learning.benchmark import Measurement
from humoslope.seal import read_json

TASK = "HumoSlope-Stage1-Unitree-G1"


def measured(task: str, typed: list[str], num_envs: int) -> Measurement:
    """A machine that steps 1,000 times a second for each world: env.step takes twice and PPO four times as long, the
    terrain descriptor a twentieth."""
    raw = 1000.0 * num_envs
    return Measurement(
        num_envs=num_envs,
        raw=[raw] * 3,
        env=[raw / 2, raw / 2, raw / 10],
        ppo=[raw / 4] * 3,
        descriptor_s=[5e-5, 5e-5, 2e-4],
        collection_s=[0.1] * 3,
        learning_s=[0.05] * 3,
        peak_mib=500.0 + num_envs,
        parts={"physics": 0.75, "rest": 0.25},
    )


measure_apart = bench._measure_apart


@pytest.fixture(autouse=True)
def machine(monkeypatch):
    monkeypatch.setattr(bench, "_measure_apart", measured)


def test_the_table_shows_medians_shares_memory_and_relative_cost(capsys):
    assert main(["bench", TASK, "--sizes", "512", "256"]) == 0
    rows = [line.replace("│", " ").split() for line in capsys.readouterr().out.splitlines()]
    assert ["256", "256,000", "128,000", "50%", "64,000", "25%", "100", "50", "756", "1.00"] in rows
    assert ["512", "512,000", "256,000", "50%", "128,000", "25%", "100", "50", "1,012", "0.50"] in rows
    assert ["256", "0.05", "5.0%"] in rows
    assert ["physics", "75.0%"] in rows


def test_the_file_holds_every_round(tmp_path, capsys):
    out = tmp_path / "new" / "bench.json"
    assert main(["bench", TASK, "--sizes", "8", "--preset", "cpu", "--out", str(out)]) == 0
    assert '"sha256": "' in out.read_text()
    report = read_json(out)
    assert report["task"] == TASK
    assert report["preset"] == "cpu"
    assert report["sizes"][0]["env"] == [4000.0, 4000.0, 800.0]
    assert list(out.parent.iterdir()) == [out]


def test_a_gpu_is_named_with_its_memory(tmp_path, monkeypatch, capsys):
    def on_card(task, typed, num_envs):
        return dataclasses.replace(measured(task, typed, num_envs), device="Card, 80 GiB", card_mib=4000.0 + num_envs)

    monkeypatch.setattr(bench, "_measure_apart", on_card)
    out = tmp_path / "bench.json"
    assert main(["bench", TASK, "--sizes", "512", "--preset", "gpu", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "Card, 80 GiB" in printed
    assert "4,512" in printed
    assert "Aims of the cpu preset" not in printed
    assert '"sha256": "' in out.read_text()
    report = read_json(out)
    assert report["machine"]["device"] == "Card, 80 GiB"
    assert report["sizes"][0]["card_mib"] == 4512.0


def test_a_measurement_that_is_stopped_is_not_waited_for(monkeypatch):
    """Of so many rounds that it would never end."""

    def stop(future):
        raise Terminated(signal.SIGTERM)

    monkeypatch.setattr(Future, "result", stop)
    with pytest.raises(Terminated):
        measure_apart(TASK, ["--rounds", "1000000"], 1)
    assert multiprocessing.active_children() == []
