"""A resumed run has one curve, and it is the one that training went on from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from humoslope.errors import UserError
from humoslope.evaluation.report.curve import STEPS, draw, read_curves, smooth


def write_events(run: Path, name: str, begun: float, curves: dict[str, dict[int, float]]) -> None:
    """An event file as a training run leaves it."""
    run.mkdir(parents=True, exist_ok=True)
    with (run / f"events.out.tfevents.{name}").open("wb") as file:
        writer = RecordWriter(file)
        writer.write(Event(wall_time=begun, file_version="brain.Event:2").SerializeToString())
        for tag, curve in curves.items():
            for step, value in curve.items():
                summary = Summary(value=[Summary.Value(tag=tag, simple_value=value)])
                writer.write(Event(wall_time=begun + step, step=step, summary=summary).SerializeToString())


def test_where_a_run_was_resumed_the_later_file_holds(tmp_path: Path) -> None:
    # Named against their order, so that only the time in the file can tell.
    write_events(tmp_path, "9", 100.0, {"Train/reward": dict.fromkeys(range(10), 1.0)})
    write_events(tmp_path, "1", 200.0, {"Train/reward": dict.fromkeys(range(6, 8), 2.0)})
    assert read_curves(tmp_path)["Train/reward"] == {**dict.fromkeys(range(6), 1.0), 6: 2.0, 7: 2.0}


def test_a_process_that_died_before_its_first_iteration_takes_nothing_away(tmp_path: Path) -> None:
    write_events(tmp_path, "1", 100.0, {"Train/reward": {0: 1.0, 1: 1.5}})
    write_events(tmp_path, "2", 200.0, {})
    assert read_curves(tmp_path)["Train/reward"] == {0: 1.0, 1: 1.5}


def test_every_point_of_a_long_run_is_read(tmp_path: Path) -> None:
    write_events(tmp_path, "1", 0.0, {"Train/reward": {i: float(i) for i in range(12_000)}})
    assert len(read_curves(tmp_path)["Train/reward"]) == 12_000  # the reader keeps 10,000 unless told otherwise


def test_a_folder_without_curves_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="holds no curves"):
        read_curves(tmp_path)
    with pytest.raises(UserError, match="nowhere' does not exist"):
        read_curves(tmp_path / "nowhere")


def test_curves_without_environment_steps_cannot_be_drawn(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=STEPS):
        draw({"Train/reward": {0: 1.0}}, "run", tmp_path / "a.png")


def test_a_single_iteration_can_be_drawn(tmp_path: Path) -> None:
    draw({"Train/reward": {0: 1.0}, STEPS: {0: 12288.0}}, "run", tmp_path / "deep" / "a.png")
    assert (tmp_path / "deep" / "a.png").read_bytes().startswith(b"\x89PNG")


@given(
    values=st.lists(st.floats(-100, 100), min_size=1, max_size=40),
    window=st.integers(1, 9),
)
def test_smoothing_stays_within_the_values_and_leaves_a_constant_alone(values: list[float], window: int) -> None:
    found = smooth(np.array(values), window)
    assert len(found) == len(values)
    assert found.min() >= min(values) - 1e-9
    assert found.max() <= max(values) + 1e-9
    np.testing.assert_allclose(smooth(np.full(7, values[0]), window), values[0], atol=1e-9)
