"""Every field of a task is an option of the command line, and presets change nothing but the scale."""

from __future__ import annotations

import inspect
import re
from dataclasses import dataclass
from functools import cache, reduce
from typing import Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.cli.options import parse
from humoslope.cli.train import TrainArgs
from humoslope.errors import UserError
from humoslope.learning.config import AgentCfg, PpoCfg
from humoslope.managers import RewardTermCfg
from humoslope.presets import apply_preset
from humoslope.provenance import plain
from humoslope.registry import all_tasks, build_task
from humoslope.words import merge_options

SCALE = {
    "env.num_envs",
    "env.sim.timestep",
    "env.sim.decimation",
    "env.sim.cone",
    "agent.hidden_dims",
    "agent.num_learning_epochs",
    "agent.mixed_precision",
    # FastTD3, whose authors have other horizons and supports at smaller scale.
    *(
        f"agent.{name}"
        for name in ("critic_hidden_dims", "num_atoms", "gamma", "num_updates", "batch_size", "buffer_steps")
    ),
}
OF_ITS_OWN = {
    "Gallant-Unitree-G1": {"agent.num_steps_per_env", "env.observations.voxels.terms.columns.params.cell"},
}
"""What a preset changes in one task alone; the reduced grid is part of the name of its results."""


def flat(value: Any, prefix: str = "") -> dict[str, Any]:
    """Every leaf of a configuration by its path."""
    if not isinstance(value, dict):
        return {prefix: value}
    return {k: v for name, child in value.items() for k, v in flat(child, f"{prefix}.{name}".strip(".")).items()}


@pytest.mark.parametrize("preset", ["cpu", "gpu"])
def test_a_preset_changes_the_scale_of_a_task_and_nothing_else(preset):
    for name in all_tasks():
        cfg = build_task(name)
        before = flat(plain(cfg))
        apply_preset(cfg, preset)
        after = flat(plain(cfg))
        assert before.keys() == after.keys()
        assert {path for path in before if before[path] != after[path]} <= SCALE | OF_ITS_OWN.get(name, set())


def test_an_unknown_preset_is_refused_with_those_there_are(task):
    with pytest.raises(UserError, match="preset 'cpus' does not exist; did you mean 'cpu'?"):
        apply_preset(build_task(task), "cpus")


@pytest.fixture(scope="module")
def without_options(task):
    """without_options("cpu"): every leaf of the task's configuration with this preset and no other option."""
    return cache(lambda preset: flat(plain(parse(TrainArgs(), task, ["--preset", preset])[0])))


@pytest.mark.parametrize(
    ("options", "path", "value"),
    [
        (["--env.rewards.alive.weight", "0.3"], "env.rewards.alive.weight", 0.3),
        (["--env.rewards.alive.weight=0.3"], "env.rewards.alive.weight", 0.3),
        (["--env.rewards.track-velocity.params.std", "0.4"], "env.rewards.track_velocity.params.std", 0.4),
        (["--env.rewards.track_velocity.params.std", "0.4"], "env.rewards.track_velocity.params.std", 0.4),
        (["--env.rewards.fall.weight", "-50"], "env.rewards.fall.weight", -50.0),
        (["--env.scene.terrain.levels", "5"], "env.scene.terrain.levels", 5),
        (["--env.scene.terrain.columns.ramp-up", "0.5"], "env.scene.terrain.columns.ramp-up", 0.5),
        (["--env.command.speed", "0.2", "0.4"], "env.command.speed", [0.2, 0.4]),
        (["--env.events.friction.params.friction", "0.5", "1"], "env.events.friction.params.friction", [0.5, 1.0]),
        (["--env.curriculum.harness.params.rate", "0.01"], "env.curriculum.harness.params.rate", 0.01),
        (["--env.sim.cone", "elliptic"], "env.sim.cone", "elliptic"),
        (["--env.observations.actor.no-enable-corruption"], "env.observations.actor.enable_corruption", False),
        (["--agent.hidden-dims", "64", "32"], "agent.hidden_dims", [64, 32]),
        (["--agent.critic-hidden-dims", "64", "32"], "agent.critic_hidden_dims", [64, 32]),
        (["--agent.activation", "tanh"], "agent.activation", "tanh"),
        (["--preset", "gpu", "--env.num-envs", "16"], "env.num_envs", 16),
    ],
)
def test_one_option_changes_one_field_however_deep(task, without_options, options, path, value):
    preset = options[1] if "--preset" in options else "cpu"
    before = without_options(preset)
    after = flat(plain(parse(TrainArgs(), task, ["--preset", preset, *options])[0]))
    assert after[path] == value
    assert {key for key in after if after[key] != before.get(key)} == {path}


def test_the_task_itself_is_not_changed_by_options(task):
    before = plain(build_task(task))
    parse(
        TrainArgs(),
        task,
        ["--preset", "cpu", "--env.rewards.alive.weight", "7", "--env.scene.terrain.columns.flat", "1"],
    )
    assert plain(build_task(task)) == before


def test_every_option_in_the_help_belongs_to_the_configuration(task, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    with pytest.raises(SystemExit):
        parse(TrainArgs(), task, ["--help"])
    named = set(re.findall(r"--((?:env|agent)\.[\w.-]+)", capsys.readouterr().out))
    cfg = build_task(task)
    leaves = flat(plain({"env": cfg.env, "agent": cfg.agent}))
    known = {path.replace("_", "-") for path in leaves}
    negations = {name for name in named if ".no-" in name and name.replace(".no-", ".") in named}
    beyond = named - negations - known
    assert len(named & known) > 100
    assert beyond  # parameters that the task leaves to their defaults
    for name in beyond:
        *path, params, parameter = name.replace("-", "_").split(".")
        assert params == "params"
        assert parameter in inspect.signature(reduce(getattr, path, cfg).func).parameters
    # Functions and the robot are what they are; only what cannot be written on a command line is missing.
    missing = {path for path in leaves if path.replace("_", "-") not in named and ".robot." not in path}
    assert {path.rpartition(".")[2] for path in missing} <= {"func", "noise_source", "params"} | {
        path.rpartition(".")[2] for path in missing if leaves[path] is None
    }


@dataclass
class FewerCfg(AgentCfg):
    """An agent with an option of its own.

    Attributes:
        updates: Gradient steps for each control step.
    """

    updates: int = 2


def test_the_options_of_an_agent_are_those_of_its_own_type(task, monkeypatch):
    cfg = build_task(task)
    cfg.agent = FewerCfg()
    monkeypatch.setattr("humoslope.cli.options.build_task", lambda name: cfg)
    parsed, _ = parse(TrainArgs(), task, ["--preset", "cpu", "--agent.updates", "5"])
    assert type(parsed.agent) is FewerCfg
    assert parsed.agent.updates == 5


def scaled(env, gain: float = 1.0, mode: Literal["sum", "mean"] = "sum", body: str | None = None):
    """Reward for a test.

    Args:
        gain: Factor on the value.
        mode: Way in which feet are combined.
        body: Name of a body; None for the root.
    """


@pytest.mark.parametrize(
    ("options", "params"),
    [
        ([], {"gain": 2}),
        (["gain", "0.5"], {"gain": 0.5}),
        (["mode", "mean"], {"gain": 2, "mode": "mean"}),
        (["mode", "sum"], {"gain": 2}),
        (["body", "torso"], {"gain": 2, "body": "torso"}),
    ],
)
def test_a_parameter_has_the_type_that_its_function_declares_and_is_written_only_where_it_was_changed(
    task, monkeypatch, options, params
):
    cfg = build_task(task)
    cfg.env.rewards.scaled = RewardTermCfg(scaled, {"gain": 2})  # a whole number where the function takes any
    monkeypatch.setattr("humoslope.cli.options.build_task", lambda name: cfg)
    typed = [f"--env.rewards.scaled.params.{options[0]}", *options[1:]] if options else []
    assert parse(TrainArgs(), task, ["--preset", "cpu", *typed])[0].env.rewards.scaled.params == params


def test_a_parameter_outside_its_choices_is_refused(task, monkeypatch, capsys):
    cfg = build_task(task)
    cfg.env.rewards.scaled = RewardTermCfg(scaled)
    monkeypatch.setattr("humoslope.cli.options.build_task", lambda name: cfg)
    with pytest.raises(SystemExit) as stop:
        parse(TrainArgs(), task, ["--env.rewards.scaled.params.mode", "median"])
    assert stop.value.code == 2
    said = capsys.readouterr().err
    assert "'median'" in said
    assert "--env.rewards.scaled.params.mode" in said


words = st.sampled_from(["--a", "--b-c", "--d=1", "--e", "x", "-0.5", "2"])


@given(first=st.lists(words), then=st.lists(words))
def test_merged_options_hold_each_name_once_and_the_later_one_wins(first, then):
    first, then = ["--first", *first], ["--then", *then]
    merged = merge_options(first, then)
    names = [word.partition("=")[0] for word in merged if word.startswith("--")]
    assert len(names) == len(set(names))
    assert merge_options(merged, []) == merged
    assert merge_options(merged, then) == merged
    assert merge_options([], then) == merged[len(merged) - len(merge_options([], then)) :]


def test_an_option_replaces_one_of_the_same_name_however_it_is_spelt():
    assert merge_options(["--a_b", "1", "2", "--c"], ["--a-b=3"]) == ["--c", "--a-b=3"]
    assert merge_options(["--a", "1", "--resume", "x"], [], without=("--resume",)) == ["--a", "1"]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("max_iterations", 0),
        ("num_steps_per_env", 0),
        ("save_interval", 0),
        ("num_learning_epochs", 0),
        ("num_mini_batches", 0),
        ("hidden_dims", ()),
        ("hidden_dims", (8, 0)),
        ("critic_hidden_dims", ()),
        ("activation", "elo"),
        ("init_std", 0.0),
        ("learning_rate", -1e-3),
        ("learning_rate", float("nan")),
        ("desired_kl", 0.0),
        ("clip_param", float("inf")),
        ("gamma", 1.1),
        ("lam", -0.1),
        ("logger", "tensorbord"),
    ],
)
def test_an_impossible_number_of_the_agent_is_named(field, value):
    cfg = PpoCfg()
    setattr(cfg, field, value)
    with pytest.raises(UserError, match=rf"agent\.{field}"):
        cfg.check()
