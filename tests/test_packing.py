"""A configuration survives the way into a checkpoint and back, and a foreign one executes nothing."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import pytest

from humoslope import packing
from humoslope.env import SimCfg
from humoslope.errors import UserError
from humoslope.managers import RewardTermCfg, Terms
from humoslope.mdp import rewards
from humoslope.packing import NAME, TYPE, describe, differences, pack, unpack
from humoslope.provenance import plain
from humoslope.registry import all_tasks, build_task, content_packages
from robots.unitree_g1 import UNITREE_G1

PLAIN = (bool, int, float, str, type(None))


def leaves(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return [leaf for child in value.values() for leaf in leaves(child)]
    if isinstance(value, list | tuple):
        return [leaf for child in value for leaf in leaves(child)]
    return [value]


def test_every_task_comes_back_as_it_was() -> None:
    for name in all_tasks():
        cfg = build_task(name)
        packed = pack(cfg)
        assert all(isinstance(leaf, PLAIN) for leaf in leaves(packed)), name
        again = unpack(packed, content_packages())
        assert plain(again) == plain(cfg), name
        assert type(again.agent) is type(cfg.agent), name
        assert again.env.scene.robot is cfg.env.scene.robot, name


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ({NAME: "os:system"}, "'os:system' lies outside the packages"),
        ({NAME: "humoslope.files:write_text"}, "lies outside the packages"),
        ({NAME: "humoslope.mdp.rewards:alife"}, "'humoslope.mdp.rewards:alife' does not exist any more"),
        ({NAME: "tasks.nothing:here"}, "'tasks.nothing:here' does not exist any more"),
        ({TYPE: "subprocess:Popen", "args": "true"}, "lies outside the packages"),
        ({TYPE: "humoslope.files:write_text", "path": "x"}, "is no configuration class"),
        ({TYPE: "humoslope.env:SimCfg", "colour": 1}, "'humoslope.env:SimCfg' has changed since"),
        ({"$robot": "g2", "module": "robots.unitree_g1.model"}, "robot 'g2' is not in 'robots.unitree_g1.model'"),
        ({"$robot": "g1", "module": "robots.gone"}, "'robots.gone', which had robot 'g1', does not exist any more"),
        ({"$robot": "g1", "module": "os"}, "robot 'g1' lies outside the packages"),
    ],
)
def test_a_name_that_leads_nowhere_or_elsewhere_is_refused(value: Any, said: str) -> None:
    with pytest.raises(UserError, match=said):
        unpack({"inner": [value]}, content_packages())


def test_what_has_no_name_of_its_own_is_refused_when_it_is_packed() -> None:
    with pytest.raises(UserError, match="define it at the top level of a module"):
        pack(Terms(reward=RewardTermCfg(lambda env: env.zeros())))
    with pytest.raises(UserError, match="cannot be kept in a checkpoint"):
        pack({"value": 1j})


def test_differences_are_named_by_their_paths() -> None:
    one, other = plain(SimCfg()), plain(SimCfg(timestep=0.002, cone="pyramidal"))
    assert differences(one, other) == ["timestep", "cone"]
    assert differences({"a": (1, 2)}, {"a": [1, 2]}) == []
    assert differences({"a": {"b": 1}}, {"a": {"c": 1}}) == ["a.b", "a.c"]
    assert differences(one, one) == []


def test_a_robot_is_described_by_its_numbers_and_the_hash_of_its_model() -> None:
    one = describe(UNITREE_G1)
    assert one["joint_names"] == list(UNITREE_G1.joint_names)
    assert one == describe(UNITREE_G1)
    assert not {"urdf", "meshes", "make_spec"} & one.keys()


def test_a_renamed_function_is_found_under_its_new_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(packing.RENAMED, "humoslope.mdp.rewards:living", "humoslope.mdp.rewards:alive")
    assert unpack({NAME: "humoslope.mdp.rewards:living"}, ()) is rewards.alive


@pytest.mark.parametrize(("before", "now"), packing.RENAMED.items())
def test_what_was_renamed_is_gone_and_its_new_name_is_there(before: str, now: str) -> None:
    assert callable(unpack({NAME: before}, ()))
    assert unpack({NAME: before}, ()) is unpack({NAME: now}, ())
    module, _, path = before.partition(":")
    assert not hasattr(import_module(module), path)
