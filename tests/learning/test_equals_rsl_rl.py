"""The training loop does to PPO exactly what rsl_rl's own runner does."""

from __future__ import annotations

import pytest
import torch
from rsl_rl.runners import OnPolicyRunner

from humoslope.learning.ppo import PpoLearner

ITERATIONS = 3


@pytest.mark.parametrize("options", [[], ["--agent.no-symmetry"], ["--agent.no-obs-normalization"]])
def test_every_weight_and_random_number_is_that_of_rsl_rls_loop(make_trainer, options):
    ours = make_trainer(*options)
    ours.start_episodes()
    for _ in range(ITERATIONS):
        ours.iterate()
    drawn = torch.rand(4)

    theirs = make_trainer(*options).learner
    assert isinstance(theirs, PpoLearner)
    OnPolicyRunner.learn(theirs, ITERATIONS, init_at_random_ep_len=True)
    assert torch.equal(drawn, torch.rand(4))
    for part in ("actor", "critic"):
        one, other = (getattr(learner.alg, part).state_dict() for learner in (ours.learner, theirs))
        assert all(torch.equal(value, other[name]) for name, value in one.items()), part
    assert ours.learner.alg.learning_rate == theirs.alg.learning_rate


def test_every_number_of_the_agent_reaches_the_algorithm(on_shared_env):
    names = ("gamma", "lam", "clip_param", "value_loss_coef", "entropy_coef", "max_grad_norm")
    values = {name: round(0.123 + 0.1 * place, 3) for place, name in enumerate(names)}
    options = [word for name, value in values.items() for word in (f"--agent.{name.replace('_', '-')}", str(value))]
    alg = on_shared_env(*options).learner.alg
    assert {name: getattr(alg, name) for name in names} == values


def test_the_other_settings_of_the_agent_reach_the_algorithm(on_shared_env):
    alg = on_shared_env("--agent.mixed-precision", "--agent.desired-kl", "0.02").learner.alg
    assert alg.use_mixed_precision
    assert (alg.desired_kl, alg.schedule) == (0.02, "adaptive")
    assert (alg.num_mini_batches, alg.num_learning_epochs) == (2, 1)
    assert alg.symmetry.use_data_augmentation
    assert on_shared_env("--agent.no-symmetry").learner.alg.symmetry is None


def test_the_least_deviation_reaches_both_networks(on_shared_env):
    alg = on_shared_env("--agent.least-obs-std", "0.3").learner.alg
    assert [network.obs_normalizer.least_std for network in (alg.actor, alg.critic)] == [0.3, 0.3]


def test_the_schedule_is_fixed_only_while_the_actor_is_held(on_shared_env):
    trainer = on_shared_env("--agent.critic-warmup-iterations", "2")
    schedules = []
    for _ in range(3):
        trainer.iterate()
        schedules.append(trainer.learner.alg.schedule)
    assert schedules == ["fixed", "fixed", "adaptive"]


def test_the_entropy_bonus_falls_linearly_until_the_last_iteration(on_shared_env):
    trainer = on_shared_env("--agent.max-iterations", "3", "--agent.final-entropy-coef", "0.001")
    weights = []
    for _ in range(3):
        trainer.iterate()
        weights.append(trainer.learner.alg.entropy_coef)
    assert weights == pytest.approx([0.002, 0.0015, 0.001], rel=1e-12)
