"""Every parameter of every registered task's terms is checked when the term is built, and refused in one sentence."""

from __future__ import annotations

import dataclasses
import inspect
import math

import pytest

from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.managers.terms import bind
from humoslope.registry import all_tasks, build_task, load_content
from humoslope.terrain.grid import TerrainGridCfg

load_content()
TASKS = list(all_tasks())
NAN, INF = math.nan, math.inf
MASKED = ("env", "mask")
IMPLICIT = {"reward": ("env",), "termination": ("env",), "observation": ("env",), "event": MASKED, "curriculum": MASKED}
UNLIMITED = {"height_scan.clip", "zmp.acc_limit", "zmp.largest_deviation"}
"""Where infinity says that there is no limit."""
SIGNED = {
    *("com_height.offset_up", "com_height.offset_down", "knee_braking.flexion", "knee_braking.rise"),
    *("swing_hip.beta0", "swing_hip.beta1", "mass.added", "root.along", "root.across", "root.yaw"),
    *("joints.position", "joints.velocity"),
    *("root_height.target", "foot_clearance.target", "root_too_low.height"),  # world heights of the literal baseline
}
"""Where a negative value has a meaning."""
NAMES = {"joints", "by", "hip", "knee", "ankle", "knees", "hips", "body", "cue", "event", "harness", "plane"}


def terms_of(task):
    """Kind, name and term of everything that a task configures."""
    cfg = build_task(task).env
    for group in dict(cfg.observations.items()).values():
        yield from (("observation", name, term) for name, term in group.terms.items())
    for kind, terms in (
        ("reward", cfg.rewards),
        ("termination", cfg.terminations),
        ("event", cfg.events),
        ("curriculum", cfg.curriculum),
    ):
        yield from ((kind, name, term) for name, term in terms.items())


def parameters_of(kind, term):
    """Name and value of each parameter that can be set, those at their default among them."""
    implicit = ("env",) if inspect.isclass(term.func) else IMPLICIT[kind]
    for name, parameter in inspect.signature(term.func).parameters.items():
        if name not in implicit:
            yield name, term.params.get(name, parameter.default)


@pytest.fixture(scope="module")
def env():
    """An environment with everything that a term of any task may refer to."""
    cfg = build_task("HumoSlope-Stage1-Unitree-G1").env
    cfg.observers.slope_gait = build_task("HumoSlope-Stage2-Unitree-G1").env.observers.slope_gait
    cfg.num_envs, cfg.sim.backend, cfg.sim.device = 2, "native", "cpu"
    return ManagerBasedRlEnv(cfg)


@pytest.fixture(scope="module")
def refusal(env):
    """refusal("reward", "pitch", term, slope_share=nan): the sentence with which the term is refused, or None."""

    def refuse(kind, name, term, **changes):
        changed = dataclasses.replace(term, params={**term.params, **changes})
        try:
            bind(kind, name, changed, env, IMPLICIT[kind])
        except UserError as error:
            return str(error)
        return None

    return refuse


def is_number(value):
    """Whether it is a number or a range."""
    return isinstance(value, int | float) or (isinstance(value, tuple) and not isinstance(value[0], str))


def changed(value, number):
    """The value with `number` in place of its number, or of each of its two in turn."""
    return [(number, value[1]), (value[0], number)] if isinstance(value, tuple) else [number]


def test_every_term_of_every_task_is_accepted_as_it_is(refusal):
    for task in TASKS:
        for kind, name, term in terms_of(task):
            assert refusal(kind, name, term) is None


@pytest.mark.parametrize("task", TASKS)
def test_no_number_of_any_term_may_be_nan_or_infinite(refusal, task):
    seen = 0
    for kind, name, term in terms_of(task):
        numbers = {key: value for key, value in parameters_of(kind, term) if is_number(value)}
        for key, value in numbers.items():
            for bad in [v for number in (NAN, INF, -INF) for v in changed(value, number)]:
                said = refusal(kind, name, term, **{key: bad})
                if bad == INF and f"{name}.{key}" in UNLIMITED:
                    assert said is None
                    continue
                assert said is not None, f"{kind} {name}: {key} = {bad}"
                assert said.startswith(f"{kind} '{name}': {key} is "), said
                assert said.endswith(".")
                assert "\n" not in said
                seen += 1
    assert seen > 100


def test_no_range_of_any_term_may_be_reversed(refusal):
    seen = set()
    for task in TASKS:
        for kind, name, term in terms_of(task):
            for key, value in parameters_of(kind, term):
                if isinstance(value, tuple) and is_number(value):
                    said = refusal(kind, name, term, **{key: (0.6, 0.3)})
                    assert "(lowest, highest)" in (said or ""), f"{name}.{key}"
                    seen.add(f"{name}.{key}")
    assert seen == {
        *("mass.added", "gains.stiffness", "gains.damping", "friction.friction"),
        *("root.along", "root.across", "root.yaw", "joints.position", "joints.velocity"),
        *("link_masses.factor", "strength.strength", "armature.factor", "joint_damping.damping"),
        *("contact_softness.time_constant", "control_delay.delay", "observation_age.age"),
        *("pace.pace", "feet_apart.span", "legs_apart.span"),
    }


def test_only_numbers_with_a_sign_of_their_own_may_be_negative(refusal):
    accepted = set()
    for task in TASKS:
        for kind, name, term in terms_of(task):
            for key, value in parameters_of(kind, term):
                if is_number(value):
                    bad = (-0.2, -0.1) if isinstance(value, tuple) else -0.1
                    if refusal(kind, name, term, **{key: bad}) is None:
                        accepted.add(f"{name}.{key}")
    assert accepted == SIGNED


def test_no_name_of_any_term_may_match_nothing(refusal):
    seen = set()
    for task in TASKS:
        for kind, name, term in terms_of(task):
            for key, value in parameters_of(kind, term):
                if isinstance(value, str):
                    for bad in ("no_such_thing", "("):
                        said = refusal(kind, name, term, **{key: bad})
                        assert said is not None, f"{name}.{key}"
                        assert said.startswith(f"{kind} '{name}': ")
                    seen.add(key)
    assert seen == NAMES


def test_a_wrong_parameter_is_refused_before_anything_is_built(make_stage1, monkeypatch):
    monkeypatch.setattr(TerrainGridCfg, "build", None)
    for change in (
        lambda cfg: cfg.rewards.zmp.params.update(sigma=NAN),
        lambda cfg: cfg.observations.critic.terms.joint_pos_rel.params.update(measured="maybe"),
        lambda cfg: cfg.curriculum.harness.params.update(rate=INF),
    ):
        with pytest.raises(UserError, match="it must be"):
            make_stage1(2, change)


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ({"speed": -1.0}, r"event 'push': speed is -1; it must be between 0 and 10 \(too low\)\."),
        ({"speed": NAN}, r"event 'push': speed is nan; it must be between 0 and 10 \(not finite\)\."),
        ({"speed": "fast"}, r"event 'push': speed is 'fast'; it must be between 0 and 10 \(not a number\)\."),
    ],
)
def test_an_event_that_first_happens_after_seconds_is_checked_when_the_environment_is_built(make_stage1, option, said):
    with pytest.raises(UserError, match=said):
        make_stage1(2, lambda cfg: setattr(cfg.events.push, "params", option))
