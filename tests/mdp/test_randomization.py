"""Randomised drives, links, contact and sensors: what is drawn, and that the physics of both backends follows it."""

from __future__ import annotations

import re
from collections.abc import Callable
from copy import copy
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from humoslope.check.host_sync import no_host_sync
from humoslope.env import EnvCfg, ManagerBasedRlEnv, SceneCfg, SimCfg
from humoslope.errors import UserError
from humoslope.managers import EventTermCfg, ObservationGroupCfg, ObservationTermCfg, RewardTermCfg, Terms
from humoslope.mdp import events, observations, randomization, rewards
from humoslope.scene.drives import Drives
from humoslope.scene.masses import Masses
from humoslope.terrain import TerrainGridCfg
from robots.unitree_g1 import UNITREE_G1

J, N = 29, 3
ALL = torch.ones(N, dtype=torch.bool)
TOLERANCE = {"native": 1e-9, "warp": 1e-4}  # rad and m; float32, which single precision of the draws does not touch
MEASURED = {
    "base_ang_vel": (observations.base_ang_vel, 3),
    "projected_gravity": (observations.projected_gravity, 3),
    "joint_pos": (observations.joint_pos_rel, J),
    "joint_vel": (observations.joint_vel, J),
}


def in_the_air(env: ManagerBasedRlEnv, mask: Tensor) -> None:
    """Reset event: nothing touches anything, and all joints and the root turn."""
    env.start_qpos[:, 2] = 5.0
    env.start_qvel[:, 3:6] = torch.tensor([0.5, -0.4, 0.3])
    env.start_qvel[:, 6:] = torch.linspace(-1.0, 1.0, J)


def make(backend: str = "native", *, fly: bool = True, num_envs: int = N, **terms: EventTermCfg) -> ManagerBasedRlEnv:
    """Envs of the G1 with these events and what its sensors measure; fields of `SimCfg` by name, such as timestep."""
    sim = {key: terms.pop(key) for key in list(terms) if key in vars(SimCfg())}
    group = ObservationGroupCfg(
        terms=Terms(**{name: ObservationTermCfg(func, {"measured": True}) for name, (func, _) in MEASURED.items()})
    )
    return ManagerBasedRlEnv(
        EnvCfg(
            scene=SceneCfg(UNITREE_G1, TerrainGridCfg(columns={"flat": 1.0}, levels=1, num_columns=1)),
            sim=SimCfg(backend=backend, device="cpu", num_threads=1, **sim),
            num_envs=num_envs,
            observations=Terms(actor=group),
            rewards=Terms(alive=RewardTermCfg(rewards.alive)),
            events=Terms(**terms, **({"air": EventTermCfg(in_the_air)} if fly else {})),
        )
    )


@pytest.fixture(params=["native", "warp"])
def backend(request: pytest.FixtureRequest) -> str:
    """Both, on the CPU."""
    return request.param


def event(func: Callable[..., None], mode: str = "startup", **params: Any) -> EventTermCfg:
    return EventTermCfg(func, params, mode=mode)


def action(step: int) -> Tensor:
    return 0.5 * torch.sin(torch.arange(J) + 0.7 * step).repeat(N, 1)


def targets(env: ManagerBasedRlEnv, step: int) -> np.ndarray:
    return (env.default_joint_pos + torch.tensor(env.robot.action_scale) * action(step)[0]).double().numpy()


def start_alone(env: ManagerBasedRlEnv, model: mujoco.MjModel, world: int) -> mujoco.MjData:
    """A plain MuJoCo simulation at the start of the world's episode."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = env.start_qpos[world].numpy(), env.start_qvel[world].numpy()
    data.ctrl[:] = env.default_joint_pos.numpy()
    if model.nhistory:
        for i in range(J):
            samples = model.actuator_history[i, 0]
            mujoco.mj_initCtrlHistory(model, data, i, None, np.full(samples, data.ctrl[i]))
    mujoco.mj_forward(model, data)
    return data


def walk_alone(env: ManagerBasedRlEnv, model: mujoco.MjModel, world: int, steps: int) -> np.ndarray:
    """Plain MuJoCo's [steps x decimation + 1, nq + nv] from the start of the world's episode."""
    data = start_alone(env, model, world)
    path = [np.concatenate([data.qpos, data.qvel])]
    for step in range(steps):
        data.ctrl[:] = targets(env, step)
        for _ in range(env.cfg.sim.decimation):
            mujoco.mj_step(model, data)
            path.append(np.concatenate([data.qpos, data.qvel]))
    return np.array(path)


# Physics follows what was drawn

DRIVES = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")
PHYSICAL = {
    "armature": (event(randomization.randomize_armature, factor=(0.5, 3.0)), ("dof_armature",)),
    "damping": (event(randomization.randomize_joint_damping, damping=(0.0, 2.0)), ("dof_damping",)),
    "friction": (event(randomization.randomize_joint_friction, friction=(0.0, 2.0)), ("dof_frictionloss",)),
    "strength": (event(randomization.randomize_motor_strength, strength=(0.5, 1.5)), DRIVES),
    "encoder": (event(randomization.randomize_encoder_bias, bias=0.1), ("actuator_biasprm", "actuator_gainprm")),
    "masses": (event(randomization.randomize_link_masses, factor=(0.5, 2.0)), ("body_mass", "body_inertia")),
    "delay": (event(randomization.randomize_control_delay, delay=(0.0, 0.03)), ("actuator_delay",)),
}


@pytest.mark.parametrize("name", PHYSICAL)
def test_each_world_moves_as_plain_mujoco_with_the_model_that_it_drew(backend: str, name: str) -> None:
    term, fields = PHYSICAL[name]
    env = make(backend, term=term, max_control_delay_s=0.03 if name == "delay" else 0.0)
    for step in range(8):
        env.step(action(step))
    ends = []
    for world in range(N):
        model = copy(env.sim.model)
        for field in fields:
            getattr(model, field)[:] = env.sim.expand(field)[world].numpy()
        mujoco.mj_setConst(model, mujoco.MjData(model))
        ends.append(walk_alone(env, model, world, 8)[-1, : model.nq])
    assert np.abs(env.sim.state("qpos").numpy() - np.array(ends)).max() < TOLERANCE[backend]
    unchanged = walk_alone(env, env.sim.model, 0, 8)[-1, : env.sim.model.nq]
    drawn = [env.sim.expand(fields[0])[world].numpy() for world in range(N)] + [getattr(env.sim.model, fields[0])]
    pairs = [(i, j) for i in range(N + 1) for j in range(i) if not np.array_equal(drawn[i], drawn[j])]
    apart = [np.abs([*ends, unchanged][i] - ends[j]).max() for i, j in pairs]
    assert len(apart) >= N, "worlds differ"
    assert min(apart) > 50.0 * TOLERANCE[backend], "what was drawn matters"


def test_softer_feet_sink_deeper(backend: str) -> None:
    """Softer feet under the robot's weight, as in plain MuJoCo."""
    env = make(backend, fly=False, soft=event(randomization.randomize_contact_softness, time_constant=(0.02, 0.08)))
    for step in range(10):
        env.step(0.0 * action(step))
    feet = [env.sim.model.geom(name).id for side in UNITREE_G1.foot_geoms for name in side]
    soft = env.sim.expand("geom_solref")[:, feet]
    assert (soft == soft[:, :1]).all()
    for world in range(N):
        model = copy(env.sim.model)
        model.geom_solref[feet, 0] = soft[world, 0, 0].item()
        data = start_alone(env, model, world)
        for _ in range(10 * env.cfg.sim.decimation):
            mujoco.mj_step(model, data)
        found = env.sim.state("qpos")[world].numpy()
        assert np.abs(found - data.qpos).max() < (1e-9 if backend == "native" else 5e-3)
    order = soft[:, 0, 0].argsort()
    height = env.sim.state("qpos")[order, 2]
    assert (height.diff() < -1e-4).all(), "the softest robot stands lowest"


def test_the_motor_obeys_its_equation(backend: str) -> None:
    """Torque by hand, with gains, strength and bias drawn in either order."""
    terms = {
        "bias": event(randomization.randomize_encoder_bias, "reset", bias=0.3),
        "gains": event(events.randomize_gains, stiffness=(0.5, 2.0), damping=(0.5, 2.0)),
        "strength": event(randomization.randomize_motor_strength, strength=(0.5, 1.5)),
        "more": event(events.randomize_gains, "reset", stiffness=(0.5, 2.0), damping=(0.5, 2.0)),
    }
    env = make(backend, **terms)
    drives = env.drives
    error = env.default_joint_pos - (env.start_qpos[:, 7:] + drives.encoder_bias)
    limit = torch.tensor(UNITREE_G1.effort_limit)
    wanted = drives.stiffness * error - drives.damping * env.start_qvel[:, 6:]
    torque = drives.strength * wanted.clamp(-limit, limit)
    torch.testing.assert_close(env.signals.joint_torque, torque, rtol=1e-4, atol=1e-4)
    assert 0.0 < (wanted.abs() > limit).float().mean() < 0.9, "some motors are at their limit"
    assert drives.encoder_bias.abs().max() > 0.2


# Sensors


def seen(env: ManagerBasedRlEnv) -> dict[str, Tensor]:
    widths = [width for _, width in MEASURED.values()]
    return dict(zip(MEASURED, env.get_observations()["actor"].split(widths, dim=1), strict=True))


def gravity_b(quat: np.ndarray) -> np.ndarray:
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, quat)
    return -axes.reshape(3, 3)[2]


def truth(env: ManagerBasedRlEnv, path: np.ndarray, age_s: float, step: int) -> dict[str, np.ndarray]:
    """What the sensors read `age_s` before the end of control step `step`, from a path of plain MuJoCo."""
    place = max(0.0, step * env.cfg.sim.decimation - age_s / env.cfg.sim.timestep)
    low, share = int(place + 1e-6), place - int(place + 1e-6)
    rows = [path[low], path[min(low + 1, len(path) - 1)]]
    mean = (1.0 - share) * rows[0] + share * rows[1]
    turned = (1.0 - share) * gravity_b(rows[0][3:7]) + share * gravity_b(rows[1][3:7])
    return {
        "base_ang_vel": mean[36 + 3 : 36 + 6],
        "projected_gravity": turned,
        "joint_pos": mean[7:36] - env.default_joint_pos.numpy(),
        "joint_vel": mean[36 + 6 :],
    }


@pytest.mark.parametrize("ages", [(0.005, 0.01, 0.02), (0.005, 0.0125, 0.047)])
def test_each_env_sees_its_sensors_as_they_were_at_its_age(backend: str, ages: tuple[float, ...]) -> None:
    env = make(backend)
    env.measurements.make_room(max(ages))
    env.measurements.age_s = torch.tensor(ages)
    env.measurements.reset(ALL)
    path = walk_alone(env, env.sim.model, 0, 5)
    for step in range(5):
        env.step(action(step))
        for world, age in enumerate(ages):
            for name, value in truth(env, path, age, step + 1).items():
                found = seen(env)[name][world].numpy()
                assert np.abs(found - value).max() < (1e-5 if backend == "native" else 2e-3), (step, age, name)


@pytest.mark.parametrize(("timestep", "decimation"), [(0.01, 2), (0.005, 4), (0.002, 10), (0.001, 20)])
def test_an_age_in_the_configuration_stays_what_it_is_when_the_physics_step_changes(
    timestep: float, decimation: int
) -> None:
    env = make(timestep=timestep, decimation=decimation, observation_age_s=0.013)
    path = walk_alone(env, env.sim.model, 0, 3)
    for step in range(3):
        env.step(action(step))
    for name, value in truth(env, path, 0.013, 3).items():
        assert np.abs(seen(env)[name].numpy() - value).max() < 1e-5


def test_a_new_episode_remembers_nothing_of_the_one_before() -> None:
    env = make(age=event(randomization.randomize_observation_age, age=(0.03, 0.03)))
    for step in range(4):
        env.step(action(step))
    middle = torch.tensor([False, True, False])
    before = {name: value.clone() for name, value in seen(env).items()}
    env._restart(middle)
    env._obs = env.observations.compute(middle)
    after = seen(env)
    for name, (func, _) in MEASURED.items():
        assert after[name][1].allclose(func(env)[1], atol=1e-6)
        assert after[name][[0, 2]].equal(before[name][[0, 2]])
        assert not after[name][1].allclose(before[name][1], atol=1e-3)


def test_without_errors_and_delay_measurements_are_the_signals() -> None:
    env = make()
    for step in range(3):
        env.step(action(step))
        for name, (func, _) in MEASURED.items():
            assert seen(env)[name].equal(func(env))


def test_the_policy_sees_the_errors_of_encoders_and_imu() -> None:
    env = make(
        encoder=event(randomization.randomize_encoder_bias, bias=0.02, joints=".*_knee_joint"),
        imu=event(randomization.randomize_imu_mounting, tilt=0.1),
        gyro=event(randomization.randomize_gyro_bias, bias=0.05),
    )
    error = seen(env)["joint_pos"] - observations.joint_pos_rel(env)
    knees = torch.tensor(["knee" in name for name in UNITREE_G1.joint_names])
    assert error[:, ~knees].count_nonzero() == 0
    assert error[:, knees].unique().numel() == 2 * N
    assert error.abs().max() <= 0.02 + 1e-6
    for world in range(N):
        imu = env.measurements.imu_rotation[world].double().numpy()
        np.testing.assert_allclose(imu @ imu.T, np.eye(3), atol=1e-6)
        cosine = (np.trace(imu) - 1.0) / 2.0
        assert 0.0 < np.arccos(cosine) <= 0.1 * np.sqrt(3.0) + 1e-6
        # The vector in the root frame is the IMU's axes times what the IMU reads.
        gravity = imu @ seen(env)["projected_gravity"][world].double().numpy()
        np.testing.assert_allclose(gravity, env.signals.projected_gravity_b[world].numpy(), atol=1e-6)
        rate = seen(env)["base_ang_vel"][world] - env.measurements.gyro_bias[world]
        np.testing.assert_allclose(imu @ rate.double().numpy(), env.signals.root_ang_vel_b[world].numpy(), atol=1e-6)
    assert env.measurements.gyro_bias.unique().numel() == 3 * N
    assert env.measurements.gyro_bias.abs().max() <= 0.05


# Ranges


class FakeSim:
    """A model with a copy of each expanded field per world."""

    def __init__(self, model: mujoco.MjModel, num_worlds: int) -> None:
        self.model, self.num_worlds, self.device = model, num_worlds, torch.device("cpu")
        self.recomputed, self.fields = 0, {}

    def expand(self, field: str) -> Tensor:
        values = torch.as_tensor(np.array(getattr(self.model, field)))
        return self.fields.setdefault(field, values.repeat(self.num_worlds, *[1] * values.dim()))

    def recompute_constants(self) -> None:
        self.recomputed += 1


M = 200
HALF = torch.arange(M) < M // 2


@pytest.fixture(scope="module")
def worlds(make_env, g1):
    """worlds(): two hundred envs with a model each, and nothing else of an environment."""

    def make() -> Any:
        sim = FakeSim(g1, M)
        cfg = SimpleNamespace(sim=SimpleNamespace(timestep=0.005, max_control_delay_s=0.03))
        return make_env(
            M,
            sim=sim,
            robot=UNITREE_G1,
            drives=Drives(sim, UNITREE_G1),
            masses=Masses(sim),
            cfg=cfg,
            body_id=lambda name: g1.body(name).id,
        )

    return make


spans = st.tuples(st.floats(0.1, 1.0), st.floats(0.1, 1.0)).map(lambda pair: (pair[0], pair[0] + pair[1]))


def fills(drawn: Tensor, low: float, high: float, rtol: float = 1e-5) -> bool:
    """Whether the numbers are in the range and reach near both ends."""
    margin = rtol * max(abs(low), abs(high))
    room = 0.1 * (high - low)
    return bool(low - margin <= drawn.min() <= low + room and high - room <= drawn.max() <= high + margin)


@given(span=spans)
def test_joint_parameters_fill_their_range_in_their_envs_and_joints_alone(worlds, span):
    knees = torch.tensor(["knee" in name for name in UNITREE_G1.joint_names])
    env = worlds()
    randomization.randomize_joint_damping(env, HALF, span, ".*_knee_joint")
    randomization.randomize_joint_friction(env, HALF, span, ".*_knee_joint")
    randomization.randomize_armature(env, HALF, span, ".*_knee_joint")
    model = env.sim.model
    nominal = torch.tensor(model.dof_armature[6:])
    armature = env.sim.expand("dof_armature")[:, 6:] / nominal
    for field, default in (
        (env.sim.expand("dof_damping")[:, 6:], 0.0),
        (env.sim.expand("dof_frictionloss")[:, 6:], 0.0),
        (armature, 1.0),
    ):
        assert fills(field[HALF][:, knees], *span)
        torch.testing.assert_close(field[HALF][:, ~knees], torch.full_like(field[HALF][:, ~knees], default))
        torch.testing.assert_close(field[~HALF], torch.full_like(field[~HALF], default))
    for field in ("dof_damping", "dof_frictionloss", "dof_armature"):
        assert env.sim.expand(field)[:, :6].count_nonzero() == 0, "the root is no joint"
    assert env.sim.recomputed == 1


def test_events_of_one_kind_for_other_joints_leave_each_others_alone(worlds):
    env = worlds()
    legs, arms = ".*_(hip|knee|ankle)_.*", ".*_(shoulder|elbow|wrist)_.*"
    for joints, span in ((legs, (2.0, 2.1)), (arms, (3.0, 3.1))):
        randomization.randomize_joint_damping(env, HALF, span, joints)
        randomization.randomize_joint_friction(env, HALF, span, joints)
        randomization.randomize_armature(env, HALF, span, joints)
        randomization.randomize_motor_strength(env, HALF, span, joints)
    randomization.randomize_encoder_bias(env, HALF, 0.2, legs)
    legs_bias = env.drives.encoder_bias.clone()
    randomization.randomize_encoder_bias(env, HALF, 0.1, arms)
    of_legs, of_waist, of_arms = slice(0, 12), slice(12, 15), slice(15, J)
    armature = env.sim.expand("dof_armature")[:, 6:] / torch.tensor(env.sim.model.dof_armature[6:])
    damping, friction = (env.sim.expand(name)[:, 6:] for name in ("dof_damping", "dof_frictionloss"))
    for values, usual in ((damping, 0.0), (friction, 0.0), (armature, 1.0), (env.drives.strength, 1.0)):
        assert fills(values[HALF][:, of_legs], 2.0, 2.1)
        assert fills(values[HALF][:, of_arms], 3.0, 3.1)
        assert (values[HALF][:, of_waist] - usual).abs().max() < 1e-6
    assert env.drives.encoder_bias[:, of_legs].equal(legs_bias[:, of_legs])
    assert fills(env.drives.encoder_bias[HALF][:, of_arms], -0.1, 0.1)
    assert env.drives.encoder_bias[:, of_waist].count_nonzero() == 0


@given(span=spans)
def test_strength_scales_gains_and_limits_alike(worlds, span):
    env = worlds()
    randomization.randomize_motor_strength(env, HALF, span)
    strength = env.drives.strength
    assert fills(strength[HALF], *span)
    assert (strength[~HALF] == 1.0).all()
    limit = torch.tensor(UNITREE_G1.effort_limit)
    force_range = env.sim.expand("actuator_forcerange").float()
    torch.testing.assert_close(force_range[:, :, 1], strength * limit)
    assert force_range[:, :, 0].equal(-force_range[:, :, 1])
    gain, bias = env.sim.expand("actuator_gainprm").float(), env.sim.expand("actuator_biasprm").float()
    torch.testing.assert_close(gain[:, :, 0], strength * torch.tensor(UNITREE_G1.stiffness))
    torch.testing.assert_close(bias[:, :, 2], -strength * torch.tensor(UNITREE_G1.damping))
    assert gain[:, :, 0].equal(-bias[:, :, 1])


@pytest.mark.parametrize("first", [True, False])
def test_a_load_that_the_lightest_link_cannot_lose_is_refused_in_any_order(worlds, first):
    env = worlds()  # the torso weighs 6.8 kg
    calls = [
        lambda: randomization.randomize_link_masses(env, HALF, (0.5, 1.0)),
        lambda: events.randomize_mass(env, HALF, "torso_link", (-5.0, 1.0)),
    ]
    before, after = calls if first else reversed(calls)
    before()
    with pytest.raises(UserError, match=r"torso_link weighs .* kg; -5 kg cannot be added to 0.5 of it\."):
        after()


@given(span=spans, first=st.booleans())
def test_masses_of_links_and_an_added_load_combine_in_any_order(worlds, span, first):
    env = worlds()
    load = lambda: events.randomize_mass(env, HALF, "torso_link", (1.0, 2.0))  # noqa: E731
    if first:
        load()
    for _ in range(3):
        randomization.randomize_link_masses(env, HALF, span)
    if not first:
        load()
    model, torso = env.sim.model, env.body_id("torso_link")
    mass, inertia = env.sim.expand("body_mass"), env.sim.expand("body_inertia")
    nominal = torch.tensor(model.body_mass)
    assert fills(env.masses.factor[HALF, 1:], *span)
    assert fills((mass[HALF, torso] - nominal[torso] * env.masses.factor[HALF, torso]), 1.0, 2.0, rtol=1e-4)
    others = [i for i in range(1, model.nbody) if i != torso]
    torch.testing.assert_close(mass[:, others], nominal[others] * env.masses.factor[:, others].double())
    share = mass[:, 1:] / nominal[1:]
    torch.testing.assert_close(
        inertia[:, 1:], torch.tensor(model.body_inertia[1:]) * share[:, :, None], rtol=1e-5, atol=0
    )
    assert mass[~HALF].equal(nominal.expand(M - M // 2, -1))


@given(low=st.integers(0, 3), more=st.integers(0, 3))
def test_delays_are_whole_steps_within_their_range(worlds, low, more):
    env = worlds()
    randomization.randomize_control_delay(env, HALF, (low * 0.005, (low + more) * 0.005))
    delay = env.sim.expand("actuator_delay")
    assert (delay == delay[:, :1]).all(), "one message carries all targets"
    steps = torch.where(delay > 0.0, delay / 0.005 + 0.5, 0.0)[:, 0]
    torch.testing.assert_close(steps, steps.round(), rtol=0, atol=1e-5)
    assert steps[HALF].round().unique().tolist() == list(range(low, low + more + 1))
    assert steps[~HALF].count_nonzero() == 0


@given(span=st.tuples(st.floats(0.02, 0.05), st.floats(0.01, 0.1)).map(lambda pair: (pair[0], sum(pair))))
def test_contact_softness_is_that_of_the_feet_alone(worlds, span):
    env = worlds()
    randomization.randomize_contact_softness(env, HALF, span)
    field, model = env.sim.expand("geom_solref"), env.sim.model
    feet = [model.geom(name).id for side in UNITREE_G1.foot_geoms for name in side]
    others = [i for i in range(model.ngeom) if i not in feet]
    assert fills(field[HALF][:, feet, 0], *span)
    assert (field[:, feet, 0] == field[:, feet[:1], 0]).all()
    assert field[:, others].equal(torch.tensor(model.geom_solref[others]).expand(M, -1, -1))
    assert (field[:, :, 1] == torch.tensor(model.geom_solref[:, 1])).all()


# Mistakes

MISTAKES = {
    "buffer": (
        {"term": event(randomization.randomize_control_delay, delay=(0.0, 0.03)), "max_control_delay_s": 0.02},
        r"event 'term': delay is \(0, 0.03\); sim.max_control_delay_s must be at least 0.03, and it is 0.02\.",
    ),
    "reversed": (
        {"term": event(randomization.randomize_control_delay, delay=(0.02, 0.01)), "max_control_delay_s": 0.02},
        r"event 'term': delay is \(0.02, 0.01\); it must be \(lowest, highest\), each 0 or more \(the first is higher"
        r"\)\.",
    ),
    "masses": (
        {"term": event(randomization.randomize_link_masses, factor=(0.0, 1.0))},
        r"event 'term': factor is \(0, 1\); it must be \(lowest, highest\), each positive \(too low\)\.",
    ),
    "joints": (
        {"term": event(randomization.randomize_joint_damping, damping=(0.0, 1.0), joints="tail")},
        r"event 'term': joints is 'tail'; joint pattern 'tail' matches nothing; .*\.",
    ),
    "stiff": (
        {"term": event(randomization.randomize_contact_softness, time_constant=(0.005, 0.03))},
        r"event 'term': time_constant is \(0.005, 0.03\); it must be 0.01 s or more, two physics steps, .*\.",
    ),
    "young": (
        {"term": event(randomization.randomize_observation_age, age=(0.001, 0.03))},
        r"event 'term': age is \(0.001, 0.03\); it must be 0.005 s or more, one physics step, .*\.",
    ),
    "fixed age": (
        {"observation_age_s": 0.001},
        r"sim.observation_age_s is 0.001; it must be finite and at least the physics step of 0.005 s\.",
    ),
    "room": (
        {"max_control_delay_s": -0.1},
        r"env.sim.max_control_delay_s is -0.1; it must be between 0 and 0.5 \(too low\)\.",
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_sentence(name: str) -> None:
    options, message = MISTAKES[name]
    with pytest.raises(UserError) as error:
        make(**options)
    assert re.fullmatch(message, str(error.value)), str(error.value)


# On a device


def everything(mode: str) -> dict[str, Any]:
    return {
        "delay": event(randomization.randomize_control_delay, mode, delay=(0.0, 0.02)),
        "age": event(randomization.randomize_observation_age, mode, age=(0.005, 0.03)),
        "encoder": event(randomization.randomize_encoder_bias, mode, bias=0.015),
        "imu": event(randomization.randomize_imu_mounting, mode, tilt=0.05),
        "gyro": event(randomization.randomize_gyro_bias, mode, bias=0.05),
        "strength": event(randomization.randomize_motor_strength, mode, strength=(0.9, 1.1)),
        "armature": event(randomization.randomize_armature, mode, factor=(0.9, 1.1)),
        "damping": event(randomization.randomize_joint_damping, mode, damping=(0.0, 0.1)),
        "friction": event(randomization.randomize_joint_friction, mode, friction=(0.0, 0.5)),
        "masses": event(randomization.randomize_link_masses, mode, factor=(0.9, 1.1)),
        "soft": event(randomization.randomize_contact_softness, mode, time_constant=(0.02, 0.04)),
        "max_control_delay_s": 0.02,
    }


def test_none_of_it_waits_for_the_device_even_at_every_reset() -> None:
    env = make(**everything("reset"))
    env.step(action(0))
    env.episode_length_buf[1] = env.max_episode_length - 1
    before = env.drives.strength.clone()
    with no_host_sync(env):
        for step in range(3):
            env.step(action(step))
    assert env.drives.strength[[0, 2]].equal(before[[0, 2]])
