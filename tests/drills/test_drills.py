"""The drills in short: what `make drills` does with thousands of faults, with a few."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import get_args

import pytest

from humoslope.errors import UserError
from humoslope.ranges import check_config, hints_of, in_words
from humoslope.registry import all_tasks, build_task, load_content
from tests.drills import damage, options
from tests.drills.files import make_files

load_content()
TASK = "HumoSlope-Stage1-Unitree-G1"


@pytest.fixture(scope="session")
def files(tmp_path_factory, stage1_checkpoint):
    """A whole file of each kind, and an export folder."""
    return make_files(tmp_path_factory.mktemp("files"), stage1_checkpoint)


@pytest.mark.parametrize("kind", ["checkpoint", "rollout", "result", "saved trials"])
def test_damage_is_noticed_in_every_kind_of_file(files, tmp_path, kind):
    found = damage.drill_file(kind, files[0][kind], tmp_path, count=30)
    assert found.failures == []
    assert found.tried >= 25


def test_damage_is_noticed_in_every_file_of_an_export(files, tmp_path):
    found = damage.drill_export(files[1], tmp_path, count=6)
    assert found.failures == []
    assert found.tried >= 25  # five files: network, model, contract, deploy.yaml and the list of checksums


@pytest.mark.parametrize("task", all_tasks())
def test_every_number_of_every_configuration_has_a_range_and_refuses_what_is_no_sensible_number(task):
    seen = 0
    cfg = build_task(task)
    for holder, name, value, path in options.fields_of(cfg):
        words = in_words(hints_of(type(holder)).get(name))
        assert words, f"{path} declares no range"
        for bad in (math.nan, math.inf, -math.inf, 1e300, -1e300, "many", None):
            spoilt = (bad,) * len(value) if isinstance(value, tuple) else bad
            if spoilt is None and type(None) in get_args(hints_of(type(holder))[name]):
                continue
            changed = dataclasses.replace(holder, **{name: spoilt})
            with pytest.raises(UserError, match=rf"^x\.{name} is .*; .*must be") as caught:
                check_config("x", changed)
            assert "\n" not in str(caught.value)
            seen += 1
    assert seen > 400


def test_some_values_for_any_option_are_refused_in_a_sentence_or_step():
    found = options.drill(8, seed=1, tasks=[TASK])
    assert found.failures == []
    assert found.tried == 8


def test_no_other_option_is_generated_than_a_task_has():
    names = {option.name for option in options.options_of(TASK)}
    for expected in (
        "--env.sim.timestep",
        "--env.rewards.zmp.params.sigma",
        "--agent.gamma",
        "--env.events.push.interval-s",
    ):
        assert expected in names
    assert len(names) > 150


def test_a_drill_counts_what_was_not_borne(tmp_path: Path):
    path = tmp_path / "plain.json"
    path.write_text('{"a": 1}')
    damage.READERS["plain"] = lambda path: path.read_bytes()
    try:
        found = damage.drill_file("plain", path, tmp_path / "..", count=3)
    finally:
        del damage.READERS["plain"]
    assert len(found.failures) == found.tried
