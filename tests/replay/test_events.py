"""Events that are read off a walk's columns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from humoslope.evaluation.causes import SIGNALS
from humoslope.replay import events
from humoslope.replay.rollout import Event, Rollout
from tests.evaluation import test_causes as judged

DT, ROWS = 0.02, 200


def stretches(*parts: tuple[int, object]) -> np.ndarray:
    return np.concatenate([np.full(count, value) for count, value in parts])


def test_ground_of_another_kind_is_an_event_once_it_lasts(altered: Callable[..., Rollout]) -> None:
    up = stretches((40, False), (60, True), (5, False), (45, True), (50, False))
    down = stretches((150, False), (50, True))
    slope = np.where(up, np.radians(18.0), np.where(down, np.radians(-10.0), 0.0)).astype(np.float32)
    columns = altered(uphill=up, downhill=down, slope=slope).columns
    found = events.grounds(columns, DT)
    assert [event.text for event in found] == ["level ground", "slope up of +18°", "slope down of -10°"]
    np.testing.assert_allclose([event.time for event in found], [0.02, 0.82, 3.02], atol=1e-5)


def test_every_fall_is_an_event_the_last_one_too(altered: Callable[..., Rollout]) -> None:
    columns = altered(episode=stretches((80, 0), (70, 1), (50, 2)).astype(np.int32)).columns
    np.testing.assert_allclose([e.time for e in events.falls(columns, last=False)], [1.6, 3.0], atol=1e-5)
    np.testing.assert_allclose([e.time for e in events.falls(columns, last=True)], [1.6, 3.0, 4.0], atol=1e-5)


def test_the_cause_of_each_fall_is_an_event_at_the_moment_when_it_began(altered: Callable[..., Rollout]) -> None:
    quiet = judged.walking()
    slipped, tipped = judged.during(quiet, 38, 46, **judged.SLIDES), quiet
    rows = judged.ROWS
    columns = altered(episode=stretches((rows, 0), (rows, 1), (50, 2)).astype(np.int32)).columns
    moments = np.stack(
        [np.concatenate([slipped[name], tipped[name], quiet[name][:50]]) for name in SIGNALS], axis=1
    )  # [T, S]
    fallen = [Event(DT * rows, "fall", "the robot falls"), Event(DT * 2 * rows, "fall", "the robot falls")]
    slip, tip = events.causes(columns, fallen, moments, DT)
    assert (slip.kind, slip.text) == ("cause", "first cause: slip, the left foot slides by 14 cm")
    assert slip.time == pytest.approx(DT * (38 + 1))
    assert tip.text.startswith("first cause: tip, the robot tips over")
    assert DT * rows < tip.time < fallen[1].time
    assert events.causes(columns, [], moments, DT) == []


def test_a_push_says_how_hard_and_where_to() -> None:
    (event,) = events.pushes([(2.5, 0.0, -0.3)])
    assert (event.time, event.text) == (2.5, "push of 0.30 m/s towards -90°")


def test_a_segment_is_come_to_once_between_falls(altered: Callable[..., Rollout], rollout: Rollout) -> None:
    place = rollout.columns.root_pos_w.copy()
    place[:, 0] = 5.0 + np.concatenate([np.linspace(0.5, 2.5, 120), np.linspace(1.9, 2.5, 30), np.full(50, 0.5)])
    episode = stretches((150, 0), (50, 1)).astype(np.int32)
    columns = altered(root_pos_w=place, episode=episode).columns
    found = events.segments(columns, 5.0, ["start", "up", "flat"], [1.0, 2.0, 3.0])
    assert [event.text for event in found] == ["start", "up", "flat", "start"]
    assert found[1].time < found[2].time < found[3].time == np.float32(3.02)


def test_a_contact_with_itself_is_an_event_with_its_largest_force_and_short_gaps_do_not_part_it(
    altered: Callable[..., Rollout],
) -> None:
    force = stretches((50, 0.0), (10, 20.0), (10, 0.5), (5, 80.0), (60, 0.0), (1, 3.0), (64, 0.0)).astype(np.float32)
    found = events.touches(altered(self_force=force).columns, DT)
    assert [event.text for event in found] == ["touches itself, 80 N", "touches itself, 3 N"]
    np.testing.assert_allclose([event.time for event in found], [1.02, 2.72], atol=1e-5)
    assert events.touches(altered(self_force=np.full(ROWS, np.nan, np.float32)).columns, DT) == []
