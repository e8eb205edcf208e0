"""The benchmark measures the same physics bare and inside the environment."""

from __future__ import annotations

import pytest
import torch

from humoslope.cli.options import parse
from humoslope.cli.train import TrainArgs
from humoslope.env import ManagerBasedRlEnv
from humoslope.learning import benchmark


@pytest.fixture(scope="module")
def env(task, tiny):
    return ManagerBasedRlEnv(parse(TrainArgs(), task, tiny)[0].env)


def act(env: ManagerBasedRlEnv):
    return lambda _: torch.zeros(env.num_envs, env.robot.num_joints)


def test_bare_physics_goes_through_the_states_of_the_environment(env):
    _, frames = benchmark._env_block(env, act(env))
    assert len(frames) == benchmark.BLOCK
    ends = []
    step = env.sim.step

    def keep(n: int) -> None:
        step(n)
        ends.append(env.sim.state("qpos").clone())

    before = env.sim.state("qpos").clone()
    with benchmark._hung(env.sim, "step", keep):
        assert benchmark._raw_block(env, frames) > 0.0
    for end, frame in zip(ends, frames[1:], strict=False):
        restarted = (frame["qvel"][:, 6:] == 0.0).all(dim=1)  # by the environment, after the step
        # The solver starts from another guess, so that the last digits differ.
        assert torch.allclose(end[~restarted], frame["qpos"][~restarted], atol=1e-3)
    assert torch.equal(env.sim.state("qpos"), before)


def test_the_parts_of_a_step_are_shares_of_it(env):
    parts = benchmark._parts(env, act(env))
    assert set(parts) == {*benchmark.PARTS, "rest"}
    assert sum(parts.values()) == pytest.approx(1.0)
    assert min(parts.values()) >= 0.0
    assert "step" not in vars(env.sim), "the timers are taken off again"


def test_the_descriptor_is_made_anew_each_time_and_leaves_the_robots_as_they_are(env):
    made, describe = [], env.terrain.height
    qpos, obs = env.sim.state("qpos").clone(), env.observations.compute(torch.ones(env.num_envs, dtype=torch.bool))
    size = (env.num_envs, env.cfg.scene.height_scan.size**2, 2)
    with benchmark._hung(env.terrain, "height", lambda xy: made.append(xy.shape == size) or describe(xy)):
        assert benchmark._descriptor_block(env) > 0.0
    assert sum(made) == benchmark.BLOCK
    assert env.sim.state("qpos").equal(qpos)
    again = env.observations.compute(torch.zeros(env.num_envs, dtype=torch.bool))
    assert again["critic"].equal(obs["critic"])


def test_a_measurement_has_a_value_for_each_round(task, monkeypatch):
    monkeypatch.setattr(benchmark, "BLOCK", 2)
    result = benchmark.measure(task, parse(TrainArgs(), task, ["--preset", "cpu", "--env.num-envs", "4"])[0], rounds=2)
    rounds = (result.raw, result.env, result.ppo, result.descriptor_s, result.collection_s, result.learning_s)
    for values in rounds:
        assert len(values) == 2
        assert min(values) > 0.0
    assert result.peak_mib > 100.0


def test_the_memory_of_a_card_is_what_all_pools_on_it_hold(monkeypatch):
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (70 * 2**30, 80 * 2**30))
    assert benchmark._card_mib(torch.device("cuda:0")) == 10 * 1024
    assert benchmark._card_mib(torch.device("cpu")) is None
