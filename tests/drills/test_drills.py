"""The drills in short: what `make drills` does with thousands of faults, with a few."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from pathlib import Path
from typing import get_args

import pytest

from humoslope.errors import UserError
from humoslope.ranges import check_config, hints_of, in_words
from humoslope.registry import all_tasks, build_task, load_content
from tests.drills import damage, options
from tests.drills.files import KINDS, Made
from tests.drills.report import Drill, Kept, Part, joined

load_content()
TASK = "HumoSlope-Stage1-Unitree-G1"


@pytest.fixture(scope="session")
def made(tmp_path_factory, stage1_checkpoint, exported):
    """A whole file of each kind."""
    return Made(tmp_path_factory.mktemp("files"), stage1_checkpoint, exported)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("episodes", "export", "start")])
def test_damage_is_noticed_in_every_kind_of_file(made, tmp_path, kind):
    found = damage.drill_kind(kind, made(kind), tmp_path / "spoilt", count=30)
    assert found.failures == []
    assert found.tried >= 25


@pytest.mark.parametrize("kind", ["export", "start"])
def test_damage_is_noticed_in_every_file_of_a_folder(made, tmp_path, kind):
    found = damage.drill_kind(kind, made(kind), tmp_path / "spoilt", count=6)
    assert found.failures == []
    assert found.tried >= 25  # five files: of an export the network, model, contract, deploy.yaml, and the checksums


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


@pytest.mark.parametrize("task", all_tasks())
def test_a_small_version_of_every_task_steps(task):
    """Or else the drill would take whatever refuses it for an answer to its values."""
    assert options.judge(task, []) == ("accepted", "")


def test_some_values_for_any_option_are_refused_in_a_sentence_or_step():
    found = options.drill(0, 12, seed=1)
    assert found.failures == []
    assert found.tried == 12


def test_the_values_of_the_drill_spread_over_all_options_tasks_and_kinds():
    every = {option.name for task in all_tasks() for option in options.options_of(task)}
    values = list(options.generate(2500, seed=0))
    unknown = {words[0] for _, words in values} - every
    assert every <= {words[0] for _, words in values}
    assert 50 < len(unknown) < 300  # names that nothing has, and flags in their negative form
    tasks = Counter(task for task, _ in values)
    assert set(tasks) == set(all_tasks())
    assert min(tasks.values()) > 2500 / len(tasks) / 2
    words = {word for _, words in values for word in words[1:]}
    assert words >= {word for kind in options.KINDS.values() for word in kind}


@pytest.mark.parametrize(
    ("options_", "answer"),
    [
        (["--env.num-envs", "1" + 400 * "0"], "refused"),
        (["--env.num-envs", "9" * 5000], "refused by the parser"),
        (["--env.events.com.params.body", "x" * 5000], "refused"),
        (["--env.events.com.params.body", "a\nb"], "refused"),
    ],
)
def test_what_is_out_of_all_proportion_is_refused_like_anything_else(options_, answer):
    assert options.judge(TASK, options_) == (answer, "")


def test_an_observation_group_that_does_not_exist_is_refused():
    words = ["--agent.vector-groups", "command", "", "last_actions"]
    assert options.judge("Gallant-Unitree-G1", words) == ("refused", "")


def test_finished_parts_of_the_drills_are_kept_and_those_of_other_code_are_not(tmp_path: Path):
    done: list[str] = []

    def part(which: str) -> Part:
        return Part("some: drill", which, lambda: done.append(which) or Drill("it", 3, ["bad"], {"refused": 3}))

    kept = Kept(tmp_path, "code")
    assert kept.get(part("0 50")) is None
    kept.run(part("0 50"))
    kept.run(part("50 99"))
    again = [Kept(tmp_path, "code").get(part(which)) for which in ("0 50", "50 99")]
    (whole,) = joined(again)
    assert (whole.name, whole.tried, whole.failures, whole.seen) == ("some: drill", 6, ["bad", "bad"], {"refused": 6})
    assert Kept(tmp_path, "other").get(part("0 50")) is None
    assert done == ["0 50", "50 99"]


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


def test_a_drill_counts_what_was_not_borne(tmp_path: Path, monkeypatch):
    path = tmp_path / "plain.json"
    path.write_text('{"a": 1}')
    monkeypatch.setitem(damage.READERS, "plain", lambda path: path.read_bytes())
    found = damage.drill_kind("plain", path, tmp_path / "spoilt", count=3)
    assert len(found.failures) == found.tried
