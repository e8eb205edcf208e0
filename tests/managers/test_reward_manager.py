"""The weighted sum of rewards, and the means of finished episodes."""

from __future__ import annotations

import pytest
import torch

from humoslope.errors import UserError
from humoslope.managers import RewardManager, RewardTermCfg, StatefulTerm, Terms

N = 4


def speed(env):
    return env.speed


def one(env):
    return torch.ones(env.num_envs)


@pytest.fixture
def env(make_env):
    return make_env(N, speed=torch.tensor([0.0, 1.0, 2.0, 3.0]))


def test_the_reward_is_the_sum_of_weight_times_value_times_seconds(env):
    rewards = RewardManager(env, Terms(speed=RewardTermCfg(speed, weight=2.0), alive=RewardTermCfg(one, weight=-0.5)))
    torch.testing.assert_close(rewards.compute(0.02), 0.02 * (2.0 * env.speed - 0.5))
    assert rewards.last.tolist() == [[0.0, -0.5], [2.0, -0.5], [4.0, -0.5], [6.0, -0.5]]


def test_finished_episodes_are_logged_as_their_mean_reward_per_second(env, mask):
    rewards = RewardManager(env, Terms(speed=RewardTermCfg(speed, weight=2.0), alive=RewardTermCfg(one)))
    for _ in range(50):
        rewards.compute(0.02)
    rewards.reset(mask(N, 1, 3))
    logged = env.log.flush()
    assert logged["Reward/speed"] == pytest.approx(2.0 * (1.0 + 3.0) / 2, rel=1e-5)
    assert logged["Reward/alive"] == pytest.approx(1.0, rel=1e-5)


def test_a_new_episode_starts_from_nothing_and_the_others_go_on(env, mask):
    rewards = RewardManager(env, Terms(speed=RewardTermCfg(speed)))
    rewards.compute(1.0)
    rewards.reset(mask(N, 0))
    env.speed = env.speed + 10.0
    rewards.compute(1.0)
    env.log.flush()
    rewards.reset(mask(N, 0))
    assert env.log.flush()["Reward/speed"] == pytest.approx(10.0)
    rewards.reset(mask(N, 1))
    assert env.log.flush()["Reward/speed"] == pytest.approx((1.0 + 11.0) / 2)


def test_nothing_is_logged_when_no_episode_ends(env, mask):
    rewards = RewardManager(env, Terms(alive=RewardTermCfg(one)))
    rewards.compute(1.0)
    rewards.reset(mask(N))
    assert env.log.flush() == {}


def test_stateful_rewards_are_reset_with_their_envs(env, mask):
    class Last(StatefulTerm):
        def __init__(self, env):
            self.value = env.zeros()

        def __call__(self, env):
            self.value = torch.maximum(self.value, env.speed)
            return self.value

        def reset(self, mask):
            self.value = self.value.masked_fill(mask, 0.0)

    rewards = RewardManager(env, Terms(best=RewardTermCfg(Last)))
    rewards.compute(1.0)
    rewards.reset(mask(N, 1, 2))
    env.speed = torch.zeros(N)
    assert rewards.compute(1.0).tolist() == [0.0, 0.0, 0.0, 3.0]


def test_finding_the_shapes_is_no_step_of_an_episode(env):
    class Steps(StatefulTerm):
        def __init__(self, env):
            self.steps = env.zeros()

        def __call__(self, env):
            self.steps = self.steps + 1.0
            return self.steps

        def reset(self, mask):
            self.steps = self.steps.masked_fill(mask, 0.0)

    rewards = RewardManager(env, Terms(steps=RewardTermCfg(Steps)))
    assert rewards.compute(1.0).tolist() == [1.0] * N


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
def test_a_term_that_is_not_finite_is_reported_with_its_first_step_and_its_envs(env, bad):
    rewards = RewardManager(env, Terms(speed=RewardTermCfg(speed), alive=RewardTermCfg(one)))
    good = env.speed
    for step in range(1, 6):
        env.finite.step = step
        env.speed = good.clone()
        if step >= 3:
            env.speed[step - 3] = bad  # in another env in each step
        rewards.compute(1.0)
    assert env.finite.report() == ["reward 'speed' was not finite in 3 of 4 envs (first in step 3 since the last look)"]
    env.speed = good
    rewards.compute(1.0)
    assert env.finite.report() == []


def test_a_diverged_env_earns_nothing_and_spoils_neither_report_nor_log(env, mask):
    rewards = RewardManager(env, Terms(speed=RewardTermCfg(speed)))
    env.speed = torch.tensor([1.0, torch.nan, 2.0, 3.0])
    assert rewards.compute(1.0, mask(N, 1)).tolist() == [1.0, 0.0, 2.0, 3.0]
    assert env.finite.report() == []
    rewards.reset(mask(N, 0, 1))
    assert env.log.flush()["Reward/speed"] == 0.5


@pytest.mark.parametrize("weight", [float("nan"), float("inf")])
def test_a_weight_that_is_not_finite_is_refused(env, weight):
    with pytest.raises(UserError, match=f"reward 'speed'.weight is {weight}; it must be a finite number"):
        RewardManager(env, Terms(speed=RewardTermCfg(speed, weight=weight)))


def test_a_term_of_weight_zero_is_never_computed(env):
    def broken(env):
        raise AssertionError

    assert RewardManager(env, Terms(alive=RewardTermCfg(one), broken=RewardTermCfg(broken, weight=0.0))).names == [
        "alive"
    ]


def test_an_env_without_rewards_earns_nothing_and_logs_nothing(env, mask):
    rewards = RewardManager(env, Terms(alive=RewardTermCfg(one, weight=0.0)))
    assert rewards.compute(0.02).tolist() == [0.0] * N
    rewards.reset(mask(N, 0))
    assert env.log.flush() == {}


def test_a_term_of_the_wrong_shape_is_named(env):
    def column(env):
        return env.speed[:, None]

    with pytest.raises(UserError, match=r"reward 'column' returned shape \(4, 1\); it must be \(4,\), one value per e"):
        RewardManager(env, Terms(alive=RewardTermCfg(one), column=RewardTermCfg(column)))


def test_a_term_counts_by_its_strength_from_when_it_is_set(env):
    rewards = RewardManager(env, Terms(alive=RewardTermCfg(one, weight=2.0), other=RewardTermCfg(one, weight=-1.0)))
    rewards.set_strength("other", torch.tensor(0.25))
    assert rewards.compute(0.5).tolist() == [0.5 * (2.0 - 0.25)] * N
    rewards.set_strength("other", torch.tensor(0.0))
    assert rewards.compute(0.5).tolist() == [1.0] * N
    with pytest.raises(UserError, match="reward 'alife' does not exist; did you mean 'alive'"):
        rewards.set_strength("alife", torch.tensor(1.0))
