"""The training harness, and its withdrawal."""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humoslope.errors import UserError
from humoslope.managers import TermCfg, Terms
from humoslope.managers.command import SKILLS
from humoslope.managers.terms import bind
from humoslope.mdp.harness import (
    Harness,
    HarnessCurriculum,
    SkillCurriculum,
    StrengthenRewards,
)

WEIGHT = 33.0 * 9.81
EVERYWHERE = torch.tensor([True])


@pytest.fixture(scope="module")
def bare(make_env, g1):
    """bare(4): envs of the G1 whose wrenches start at zero, without signals."""

    def make(num_envs, **attributes):
        wrench = torch.zeros(num_envs, g1.nbody, 6, dtype=torch.float64)
        return make_env(
            num_envs,
            robot=SimpleNamespace(total_mass=33.0, root_body="pelvis", torso_body="torso_link"),
            body_id=lambda name: g1.body(name).id,
            sim=SimpleNamespace(state=lambda field: wrench, model=g1),
            **attributes,
        )

    return make


@pytest.fixture(scope="module")
def hang(bare):
    """hang(rotation, spin, scale=...): the wrenches [body, force and torque] on a robot whose torso leans and spins."""

    def make(torso=None, spin=(0.0, 0.0, 0.0), **params):
        quat = (torso or Rotation.identity()).as_quat(scalar_first=True)
        env = bare(
            1,
            signals=SimpleNamespace(
                torso_quat_w=torch.tensor(np.array([quat]), dtype=torch.float32), torso_ang_vel_w=torch.tensor([spin])
            ),
        )
        harness = Harness(env, **params)
        harness(env, EVERYWHERE)
        return env.sim.state("xfrc_applied")[0].numpy()

    return make


@pytest.fixture(scope="module")
def bodies(g1):
    """Ids of the root and of the torso."""
    return g1.body("pelvis").id, g1.body("torso_link").id


def test_at_full_strength_it_carries_35_percent_of_the_weight_at_the_root_and_only_there(hang, bodies):
    wrench = hang()
    np.testing.assert_allclose(wrench[bodies[0]], [0.0, 0.0, 0.35 * WEIGHT, 0.0, 0.0, 0.0], rtol=1e-6)
    wrench[bodies[0]] = 0.0
    np.testing.assert_allclose(wrench, 0.0, atol=1e-6)


@given(heading=st.floats(-180.0, 180.0), lean=st.floats(1.0, 80.0), direction=st.floats(-180.0, 180.0))
def test_the_torque_turns_a_leaning_torso_back_upright_whatever_its_heading(hang, bodies, heading, lean, direction):
    axis = Rotation.from_euler("z", direction, degrees=True).apply([1.0, 0.0, 0.0])
    tilt = Rotation.from_rotvec(np.radians(lean) * axis)
    torque = hang(tilt * Rotation.from_euler("z", heading, degrees=True), stiffness=120.0)[bodies[1], 3:]
    np.testing.assert_allclose(torque, -120.0 * np.sin(np.radians(lean)) * axis, atol=1e-3)


def test_it_damps_roll_and_pitch_and_leaves_the_robot_free_to_turn(hang, bodies):
    torque = hang(spin=(1.0, -2.0, 5.0), damping=3.0)[bodies[1], 3:]
    np.testing.assert_allclose(torque, [-3.0, 6.0, 0.0], atol=1e-5)


@pytest.mark.parametrize("scale", [0.0, 0.25, 1.0])
def test_its_scale_weakens_all_of_it(hang, scale):
    lean = Rotation.from_euler("y", 20.0, degrees=True)
    np.testing.assert_allclose(hang(lean, scale=scale), scale * hang(lean), atol=1e-5)


@pytest.mark.parametrize("scale", [-0.1, 1.1])
def test_a_scale_beyond_its_range_is_refused(hang, scale):
    with pytest.raises(UserError, match="harness: scale .* must be between 0 and 1"):
        hang(scale=scale)


@pytest.mark.parametrize("name", ["support", "stiffness", "damping"])
@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_a_strength_that_is_no_number_from_zero_up_is_refused(hang, name, value):
    with pytest.raises(UserError, match=f"harness: {name} is {value:g}; it must be 0 or more"):
        hang(**{name: value})


@given(seed=st.integers(0, 2**32 - 1))
def test_an_episode_starts_in_the_wrench_that_its_first_state_asks_for(bare, g1, bodies, seed):
    rng, env = np.random.default_rng(seed), bare(3)
    qpos = rng.uniform(-1.0, 1.0, (3, g1.nq))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    qvel = rng.uniform(-2.0, 2.0, (3, g1.nv))
    env.start_qpos, env.start_qvel = torch.tensor(qpos).float(), torch.tensor(qvel).float()
    env.start_wrench = torch.zeros(3, g1.nbody, 6)
    Harness(env, scale=0.5).reset(torch.tensor([True, False, True]))

    root, torso = bodies
    expected = np.zeros((3, g1.nbody, 6))
    for i in range(3):
        data, velocity = mujoco.MjData(g1), np.zeros(6)
        data.qpos, data.qvel = qpos[i], qvel[i]
        mujoco.mj_forward(g1, data)
        mujoco.mj_objectVelocity(g1, data, mujoco.mjtObj.mjOBJ_XBODY, torso, velocity, 0)
        up = data.xmat[torso].reshape(3, 3)[:, 2]
        expected[i, root, 2] = 0.5 * 0.35 * WEIGHT
        expected[i, torso, 3:5] = 0.5 * (120.0 * np.cross(up, [0.0, 0.0, 1.0]) - 3.0 * velocity[:3])[:2]
    np.testing.assert_allclose(env.start_wrench.numpy(), expected, atol=2e-3, rtol=1e-4)


def test_a_torso_that_slides_on_the_root_is_refused(make_env):
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body name="root"><freejoint/><geom size="0.1" mass="1"/>
        <body name="torso"><joint type="slide"/><geom size="0.1" mass="1"/></body></body></worldbody></mujoco>"""
    )
    env = make_env(
        1,
        robot=SimpleNamespace(total_mass=2.0, root_body="root", torso_body="torso"),
        body_id=lambda name: model.body(name).id,
        sim=SimpleNamespace(state=lambda field: torch.zeros(1, 3, 6), model=model),
    )
    with pytest.raises(UserError, match="harness: only hinge joints may connect the robot's root with its torso"):
        Harness(env)


# Withdrawal

speeds = st.floats(-2.0, 2.0)

FORWARD, BACKWARD, SIDEWAYS = [0.5, 0.0, 0.1], [-0.5, 0.0, 0.0], [0.0, 0.5, 0.0]
STANDING = [0.0, 0.0, 0.0]
COMMANDS = {
    "forward": [FORWARD] * 3 + [STANDING],
    "backward": [BACKWARD] * 3 + [STANDING],
    "around zero": [FORWARD, BACKWARD, SIDEWAYS, STANDING],
}


@pytest.fixture(params=COMMANDS)
def withdrawal(bare, request):
    """withdraw(steps, falling, share): the scale after so many steps of robots falling and walking so.
    The robot that is commanded to stand drifts forward at 2 m/s."""
    env = bare(4, commands=SimpleNamespace(velocity=torch.tensor(COMMANDS[request.param])))
    env.events = {"harness": Harness(env), "push": lambda env, mask: None}

    def withdraw(steps, falling=False, share=1.0):
        env.terminations = SimpleNamespace(terminated=torch.full((4,), falling))
        velocity = share * env.commands.velocity
        velocity[3, 0] = 2.0
        env.signals = SimpleNamespace(root_lin_vel_t=velocity)
        for _ in range(steps):
            scale = withdraw.term.step(env)
        return scale.item()

    withdraw.env = env
    withdraw.make = lambda **params: HarnessCurriculum(env, **{"rate": 0.5, "memory_s": 1.0, **params})
    withdraw.term = withdraw.make()
    return withdraw


def test_nothing_is_withdrawn_before_the_robots_have_proven_themselves(withdrawal):
    assert withdrawal(20) == 1.0


def test_from_robots_that_walk_and_hardly_fall_it_is_withdrawn_at_its_rate_down_to_nothing(withdrawal):
    withdrawal(500)
    before = withdrawal(1)
    assert withdrawal(10) == pytest.approx(before - 10 * 0.5 * 0.02, abs=1e-5) or before == 0.0
    assert withdrawal(2000) == 0.0


def test_it_takes_rate_off_each_second(withdrawal):
    withdrawal.term = withdrawal.make(rate=0.01)
    before = withdrawal(500)
    assert 0.0 < before < 1.0
    assert withdrawal(500) == pytest.approx(before - 0.01 * 10.0, abs=1e-4)


def test_from_robots_that_fall_nothing_is_withdrawn(withdrawal):
    assert withdrawal(1000, falling=True) == 1.0


def test_from_robots_that_stand_in_it_nothing_is_withdrawn(withdrawal):
    assert withdrawal(1000, share=0.5) == 1.0


def test_it_stays_as_it_is_when_robots_begin_to_fall_again_and_never_comes_back(withdrawal):
    withdrawal.term = withdrawal.make(rate=0.01)
    withdrawal(1000)
    withdrawal(50, falling=True)
    held = withdrawal(1, falling=True)
    assert 0.0 < held < 1.0
    assert withdrawal(500, falling=True) == held


def test_the_log_shows_and_others_read_the_present_scale(withdrawal):
    value = withdrawal(500)
    assert withdrawal.term.scale.item() == value == withdrawal.env.events["harness"].scale.item()


def test_processes_withdraw_it_by_their_mean_fall_rate_and_speed(withdrawal):
    withdrawal.term = withdrawal.make(rate=0.01)
    withdrawal(700)
    mine = withdrawal.term.state_dict()
    other = iter([0.4, 0.2, 0.1, 0.6])  # falls, speed, scale and strictness in the other process
    withdrawal.term.average(lambda value: 0.5 * (value + next(other)))
    assert withdrawal.term.state_dict() == pytest.approx(
        {
            "falls": 0.5 * (mine["falls"] + 0.4),
            "speed": 0.5 * (mine["speed"] + 0.2),
            "scale": 0.5 * (mine["scale"] + 0.1),
            "strictness": 0.5 * (mine["strictness"] + 0.6),
        }
    )
    assert withdrawal.env.events["harness"].scale is withdrawal.term.scale


def test_withdrawal_goes_on_where_its_state_was_taken(withdrawal):
    withdrawal.term = withdrawal.make(rate=0.01)
    withdrawal(700)
    state = withdrawal.term.state_dict()
    expected = [withdrawal(1) for _ in range(5)]

    withdrawal.env.events["harness"] = Harness(withdrawal.env)
    withdrawal.term = withdrawal.make(rate=0.01)
    withdrawal.term.load_state_dict(state)
    assert [withdrawal(1) for _ in range(5)] == pytest.approx(expected, abs=1e-6)
    assert all(isinstance(value, float) for value in state.values())


@given(st.lists(st.tuples(speeds, speeds), min_size=1, max_size=6), st.floats(0.0, 1.0))
def test_the_share_of_the_commanded_speed_is_right_for_any_commands(bare, commands, share):
    env = bare(len(commands), terminations=SimpleNamespace(terminated=torch.zeros(len(commands), dtype=torch.bool)))
    velocity = torch.tensor([[*command, 0.0] for command in commands])
    assume(velocity.norm(dim=1).sum() > 0.01)
    env.commands, env.signals = SimpleNamespace(velocity=velocity), SimpleNamespace(root_lin_vel_t=share * velocity)
    env.events = {"harness": Harness(env)}
    term = HarnessCurriculum(env, memory_s=0.02)  # no memory
    term.step(env)
    assert term.state_dict()["speed"] == pytest.approx(share, abs=1e-3)


def test_while_every_robot_is_commanded_to_stand_the_share_stays_as_it_was(withdrawal):
    withdrawal(100)
    before = withdrawal.term.state_dict()["speed"]
    withdrawal.env.commands.velocity = torch.zeros(4, 3)
    withdrawal(100)
    assert withdrawal.term.state_dict()["speed"] == before


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"rate": -0.1}, "rate is -0.1; it must be 0 or more"),
        ({"falls_per_second": float("nan")}, "falls_per_second is nan; it must be 0 or more"),
        ({"strict_rate": -1.0}, "strict_rate is -1; it must be 0 or more"),
        ({"falls_unaided": -1.0}, "falls_unaided is -1; it must be 0 or more"),
        ({"memory_s": 0.0}, "memory_s is 0; it must be positive"),
    ],
)
def test_a_withdrawal_without_sense_is_refused(withdrawal, params, message):
    with pytest.raises(UserError, match=f"harness curriculum: {message}"):
        withdrawal.make(**params)


def test_only_a_harness_can_be_withdrawn(withdrawal):
    with pytest.raises(UserError, match="event 'push' is not a Harness"):
        HarnessCurriculum(withdrawal.env, event="push")


def test_strictness_grows_at_its_own_pace_once_it_is_gone_and_is_kept(withdrawal):
    withdrawal.term = withdrawal.make(rate=0.05, strict_rate=0.02)
    harness = withdrawal.env.events["harness"]
    while withdrawal(1) > 0.0:
        assert harness.strictness.item() == 0.0
    begun = harness.strictness.item()
    withdrawal(100)
    assert harness.strictness.item() - begun == pytest.approx(100 * 0.02 * withdrawal.env.step_dt, rel=1e-3)
    state = withdrawal.term.state_dict()
    withdrawal(100, falling=True)  # falls are remembered for a while
    held = harness.strictness.item()
    withdrawal(100, falling=True)
    assert harness.strictness.item() == held
    withdrawal.term.load_state_dict(state)
    assert harness.strictness.item() == pytest.approx(state["strictness"])
    withdrawal.term = withdrawal.make(rate=10.0, strict_rate=10.0)
    withdrawal(1500)
    assert harness.strictness.item() == 1.0


def test_strictness_bears_more_falls_than_the_harness_but_no_standing(withdrawal):
    def grown(**params):
        harness.strictness = torch.zeros(())
        withdrawal.term = withdrawal.make(strict_rate=0.05, falls_per_second=1.0, memory_s=0.02, **params)  # no memory
        withdrawal(10, falling=True)
        return harness.strictness.item()

    harness = withdrawal.env.events["harness"]
    harness.scale = torch.zeros(())
    every_env = 1.0 / withdrawal.env.step_dt  # falls per second
    assert grown(falls_unaided=0.99 * every_env) == 0.0
    assert grown(falls_unaided=1.01 * every_env) == pytest.approx(10 * 0.05 * withdrawal.env.step_dt, rel=1e-3)
    withdrawal(10, share=0.5)
    assert harness.strictness.item() == pytest.approx(10 * 0.05 * withdrawal.env.step_dt, rel=1e-3)


def test_where_skills_have_harnesses_of_their_own_only_robots_that_walk_ahead_count(withdrawal):
    """The other two of four robots fall and stand."""
    withdrawal.term = withdrawal.make(rate=0.01)
    withdrawal.env.events["harness"].skill_scales = torch.ones(4)
    withdrawal.env.commands.skill = torch.tensor([0, 0, 1, 4])
    withdrawal.env.terminations = SimpleNamespace(terminated=torch.tensor([False, False, True, True]))
    walked = withdrawal.env.commands.velocity * torch.tensor([1.0, 1.0, 0.0, 0.0])[:, None]
    withdrawal.env.signals = SimpleNamespace(root_lin_vel_t=walked)
    for _ in range(500):
        withdrawal.term.step(withdrawal.env)
    state = withdrawal.term.state_dict()
    assert state["scale"] < 1.0
    assert state["speed"] == pytest.approx(1.0, abs=0.01)


# Skills


@pytest.fixture
def skilled(bare):
    """skilled(steps, skill="turning", share=0.8, falling=False): the scales by skill after so many steps of five robots
    of which each is commanded one of `SKILLS`, and does all of it without falling; but the robot of `skill` does only
    `share` of it, or falls. The harness of those that walk ahead is gone."""
    command = SimpleNamespace(asks_for=lambda mode: True, standing_share=0.2)
    velocity = torch.tensor([[0.5, 0.0, 0.1], [-0.3, 0.0, 0.1], [0.0, 0.4, 0.1], [0.0, 0.0, -0.6], [0.0, 0.0, 0.0]])
    commands = SimpleNamespace(velocity=velocity, skill=torch.arange(5), moving=torch.arange(5) < 4, variety=None)
    curves = {}
    env = bare(5, commands=commands, log=SimpleNamespace(add=lambda name, value: curves.update({name: value.item()})))
    env.cfg.command = command
    env.events = {"harness": Harness(env), "push": lambda env, mask: None}
    down = torch.tensor([0.0, 0.0, -1.0])

    def practise(steps, skill="forward", share=1.0, falling=False):
        i = SKILLS.index(skill)
        shares = torch.ones(5)
        shares[i] = share
        env.terminations = SimpleNamespace(terminated=torch.zeros(5, dtype=torch.bool))
        env.terminations.terminated[i] = falling
        env.signals = SimpleNamespace(
            root_lin_vel_t=torch.cat([velocity[:, :2] * shares[:, None], torch.ones(5, 1)], dim=1),  # [5, 3]
            projected_gravity_b=down.expand(5, 3),
            root_ang_vel_b=-down * (velocity[:, 2] * shares)[:, None],
            foot_contact=(shares > 0.5)[:, None].expand(5, 2),
        )
        for _ in range(steps):
            practise.progress = practise.term.step(env).item()
        assert practise.term.scales is env.events["harness"].skill_scales
        return dict(zip(SKILLS[1:], practise.term.scales.tolist(), strict=True))

    def make(varied=True, **params):
        env.events["harness"].scale = torch.ones(())
        term = SkillCurriculum(env, **{"rate": 0.01, "memory_s": 1.0, **params})
        env.events["harness"].scale = torch.zeros(())
        if varied:
            term.load_state_dict(term.state_dict() | {"variety": [1.0] * 4})
        term.begin(env)
        return term

    practise.env, practise.curves, practise.make, practise.term = env, curves, make, make()
    return practise


def varieties(env):
    return dict(zip(SKILLS[1:], env.commands.variety.tolist(), strict=True))


def test_robots_lose_it_at_its_rate_as_they_do_what_they_are_asked(skilled):
    assert set(skilled(20).values()) == {1.0}
    before = skilled(400)
    assert all(0.0 < scale < 1.0 for scale in before.values())
    after = skilled(500)
    for skill in SKILLS[1:]:
        assert after[skill] == pytest.approx(before[skill] - 0.01 * 10.0, abs=1e-4)
        assert skilled.curves[f"Skill/{skill}"] == pytest.approx(1.0, abs=1e-3)
        assert skilled.curves[f"Harness/{skill}"] == pytest.approx(after[skill])
    assert set(skilled(10_000).values()) == {0.0}
    assert skilled.progress == 1.0


@pytest.mark.parametrize("skill", SKILLS[1:])
@pytest.mark.parametrize("wrong", [{"falling": True}, {"share": 0.4}, {"share": -1.0}])
def test_who_falls_or_does_less_than_asked_keeps_it_and_nobody_else_does(skilled, skill, wrong):
    after = skilled(1000, skill, **wrong)
    assert after.pop(skill) == 1.0
    assert max(after[name] for name in after if name != "standing") < 1.0  # that waits for the others
    skilled(3000)
    skilled(100, skill, **wrong)
    held = skilled(1, skill, **wrong)[skill]
    assert 0.0 < held < 1.0
    assert skilled(500, skill, **wrong)[skill] == held


@pytest.mark.parametrize("skill", SKILLS[1:4])
@pytest.mark.parametrize("wrong", [{"falling": True}, {"share": 0.45}])
def test_commands_turn_as_far_as_they_are_followed_before_any_harness_goes(skilled, skill, wrong):
    skilled.term = skilled.make(varied=False)
    assert set(varieties(skilled.env).values()) == {0.0}
    skilled(1000, skill, **wrong)
    after = varieties(skilled.env)
    assert after.pop(skill) == after.pop("standing") == 0.0
    for variety in after.values():
        assert variety == pytest.approx(0.2, abs=0.03)
    for name in SKILLS[1:]:
        assert skilled.curves[f"Variety/{name}"] == pytest.approx(varieties(skilled.env)[name])
    walks = [name for name in SKILLS[1:4] if name != skill]
    assert [skilled(1)[name] for name in walks] == [1.0] * 2
    skilled(6000)
    assert set(varieties(skilled.env).values()) == {1.0}
    assert max(skilled(1000).values()) < 1.0


@pytest.mark.parametrize("skill", SKILLS[1:4])
def test_commands_that_are_not_followed_turn_back_but_no_harness_comes_back(skilled, skill):
    held = skilled(2000)[skill]
    skilled(100, skill, share=0.3)
    before = varieties(skilled.env)[skill]
    skilled(500, skill, share=0.3)
    assert varieties(skilled.env)[skill] == pytest.approx(before - 0.01 * 10.0, abs=1e-4)
    assert 0.0 < skilled(1)[skill] <= held
    skilled(10_000, skill, share=0.3)
    assert varieties(skilled.env)[skill] == 0.0


@pytest.mark.parametrize(
    ("others", "variety"), [((0.0, 0.0, 0.0), 0.0), ((1.0, 0.5, 0.0), 0.0), ((1.0, 0.5, 0.6), 0.4)]
)
def test_robots_are_asked_to_stand_with_the_second_half_of_the_other_skills(skilled, others, variety):
    skilled.term = skilled.make(rate=0.0)
    skilled.term.load_state_dict(skilled.term.state_dict() | {"variety": [*others, 0.0]})
    skilled(1)
    assert varieties(skilled.env)["standing"] == pytest.approx(variety)


def test_nothing_is_learnt_of_what_nobody_is_commanded_to_do(skilled):
    skilled(400)
    before = skilled.term.state_dict()
    skilled.env.commands.skill = torch.tensor([0, 1, 2, 0, 0])
    skilled(50, "turning", share=0.0, falling=True)
    after = skilled.term.state_dict()
    for name in before:
        assert after[name][2:] == before[name][2:]
    assert after["scale"][:2] < before["scale"][:2]


def test_what_a_task_never_commands_needs_no_harness(skilled):
    skilled.env.cfg.command = SimpleNamespace(asks_for=lambda mode: mode == "turning", standing_share=0.0)
    skilled.term = skilled.make()
    assert skilled.term.scales.tolist() == [0.0, 0.0, 1.0, 0.0]
    skilled(1)
    assert skilled.progress == pytest.approx(0.5, abs=1e-3)
    skilled.term = skilled.make(varied=False)
    assert list(varieties(skilled.env).values()) == [1.0, 1.0, 0.0, 1.0]


def test_only_a_harness_can_hold_skills(skilled):
    with pytest.raises(UserError, match="event 'push' is not a Harness"):
        SkillCurriculum(skilled.env, event="push")


def test_skills_go_on_where_their_state_was_taken_and_are_shared(skilled):
    skilled(700)
    state = skilled.term.state_dict()
    assert all(isinstance(value, list) for value in state.values())
    expected = [skilled(1)["turning"] for _ in range(5)]
    skilled.term = skilled.make(varied=False)
    skilled.term.load_state_dict(state)
    assert [skilled(1)["turning"] for _ in range(5)] == pytest.approx(expected, abs=1e-6)
    mine, others = skilled.term.state_dict(), iter([0.3, 0.4, 0.2, 0.1])
    skilled.term.average(lambda value: 0.5 * (value + next(others)))
    shared = skilled.term.state_dict()
    for name, other in (("variety", 0.3), ("falls", 0.4), ("share", 0.2), ("scale", 0.1)):
        assert shared[name] == pytest.approx([0.5 * (value + other) for value in mine[name]])
    assert skilled.env.events["harness"].skill_scales is skilled.term.scales


def test_each_robot_is_held_by_what_it_is_asked_to_do_and_from_the_start_by_the_strongest(bare, bodies, g1):
    env = bare(3, commands=SimpleNamespace(skill=torch.tensor([0, 4, 2])))
    lying = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(3, 1)
    env.signals = SimpleNamespace(torso_quat_w=lying, torso_ang_vel_w=torch.ones(3, 3))
    harness = Harness(env, damping=10.0)
    harness.scale, harness.skill_scales = torch.tensor(0.25), torch.tensor([0.0, 0.75, 1.0, 0.5])
    harness(env, torch.ones(3, dtype=torch.bool))
    wrench, (root, torso) = env.sim.state("xfrc_applied"), bodies
    np.testing.assert_allclose(wrench[:, root, 2], 0.35 * WEIGHT * np.array([0.25, 0.5, 0.75]), rtol=1e-6)
    np.testing.assert_allclose(wrench[:, torso, 3], [-2.5, -5.0, -7.5], rtol=1e-6)
    env.start_qpos, env.start_qvel = torch.zeros(3, g1.nq), torch.zeros(3, g1.nv)
    env.start_qpos[:, 3], env.start_wrench = 1.0, torch.zeros(3, g1.nbody, 6)
    harness.reset(torch.ones(3, dtype=torch.bool))
    np.testing.assert_allclose(env.start_wrench[:, root, 2], 0.35 * WEIGHT, rtol=1e-6)


# Rewards and commands that grow with the training


@pytest.mark.parametrize(("params", "share"), [({}, 0.3), ({"by": "strictness"}, 0.3), ({"by": "withdrawn"}, 0.75)])
def test_rewards_grow_as_the_harness_is_withdrawn_or_with_the_strictness(bare, params, share):
    seen = {}
    env = bare(2, rewards=SimpleNamespace(set_strength=lambda name, share: seen.update({name: share.item()})))
    harness = Harness(env, scale=0.25)
    env.events, harness.strictness = {"harness": harness}, torch.tensor(0.3)
    on, off = SimpleNamespace(weight=-0.2), SimpleNamespace(weight=0.0)
    env.cfg.rewards = Terms(landings=on, other=on, switched_off=off)
    term = StrengthenRewards(env, rewards=("landings", "switched_off"), **params)
    assert term.step(env).item() == pytest.approx(share)
    assert seen == pytest.approx({"landings": share})
    harness.scale, harness.strictness = torch.tensor(0.0), torch.tensor(1.0)
    term.step(env)
    assert seen == {"landings": 1.0}


def test_a_strict_reward_that_does_not_exist_and_an_event_that_is_no_harness_are_refused(bare):
    env = bare(2)
    env.events, env.cfg.rewards = (
        {"harness": Harness(env), "push": object()},
        Terms(landings=SimpleNamespace(weight=1.0)),
    )
    with pytest.raises(UserError, match=r"reward 'landing' does not exist; did you mean 'landings'\?"):
        StrengthenRewards(env, rewards=("landing",))
    with pytest.raises(UserError, match="event 'push' is not a Harness"):
        StrengthenRewards(env, rewards=("landings",), event="push")
    term = TermCfg(StrengthenRewards, {"rewards": ("landings",), "by": "strict"})
    with pytest.raises(UserError, match="by is 'strict'; it must be 'withdrawn' or 'strictness'"):
        bind("curriculum", "strict_rewards", term, env)


BENT_AT_REST = """
<mujoco><compiler angle="radian"/><worldbody><body name="pelvis" pos="0 0 1"><freejoint/><geom size="0.1"/>
  <body name="waist" euler="0.2 0 0.1"><joint name="yaw" axis="0 0 1" ref="0.4"/><geom size="0.1"/>
    <body name="torso_link" euler="0 -0.3 0"><joint name="pitch" axis="0 1 0" ref="-0.7"/><geom size="0.1"/></body>
  </body></body></worldbody></mujoco>
"""


@given(seed=st.integers(0, 1000))
def test_the_wrench_at_the_start_is_right_for_joints_that_are_not_at_0_in_the_model_s_own_pose(make_env, seed):
    model = mujoco.MjModel.from_xml_string(BENT_AT_REST)
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    quat = rng.normal(size=4)
    data.qpos[:] = [*rng.normal(size=3), *(quat / np.linalg.norm(quat)), *rng.uniform(-1.0, 1.0, 2)]
    data.qvel[:] = rng.normal(size=8)
    mujoco.mj_forward(model, data)
    env = make_env(
        1,
        robot=SimpleNamespace(total_mass=33.0, root_body="pelvis", torso_body="torso_link"),
        body_id=lambda name: model.body(name).id,
        sim=SimpleNamespace(state=lambda field: torch.zeros(1, model.nbody, 6), model=model),
        start_qpos=torch.tensor(data.qpos[None], dtype=torch.float32),
        start_qvel=torch.tensor(data.qvel[None], dtype=torch.float32),
        start_wrench=torch.zeros(1, model.nbody, 6),
    )
    Harness(env, stiffness=100.0, damping=10.0).reset(EVERYWHERE)
    torso = model.body("torso_link").id
    up = data.xmat[torso].reshape(3, 3)[:, 2]
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, torso, velocity, 0)
    torque = 100.0 * np.cross(up, [0.0, 0.0, 1.0]) - 10.0 * velocity[:3]
    np.testing.assert_allclose(env.start_wrench[0, torso, 3:5].numpy(), torque[:2], atol=1e-4)
