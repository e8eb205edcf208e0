"""The training loop does to PPO exactly what rsl_rl's own runner does."""

from __future__ import annotations

import pytest
import torch
from rich.console import Console
from rsl_rl.runners import OnPolicyRunner

from humoslope.cli.options import parse
from humoslope.cli.train import TrainArgs
from humoslope.env import ManagerBasedRlEnv
from humoslope.learning.ppo import PpoLearner
from humoslope.learning.rng import seed_everything
from humoslope.learning.trainer import Trainer

ITERATIONS = 3


def make_trainer(task: str, tiny: list[str], *options: str) -> Trainer:
    cfg, _ = parse(TrainArgs(), task, [*tiny, *options])
    seed_everything(cfg.env.seed)
    return Trainer(task, cfg, ManagerBasedRlEnv(cfg.env), None, Console(quiet=True))


@pytest.mark.parametrize("options", [[], ["--agent.no-symmetry"], ["--agent.no-obs-normalization"]])
def test_every_weight_and_random_number_is_that_of_rsl_rls_loop(task, tiny, options):
    ours = make_trainer(task, tiny, *options)
    ours.start_episodes()
    for _ in range(ITERATIONS):
        ours.iterate()
    drawn = torch.rand(4)

    theirs = make_trainer(task, tiny, *options).learner
    assert isinstance(theirs, PpoLearner)
    OnPolicyRunner.learn(theirs, ITERATIONS, init_at_random_ep_len=True)
    assert torch.equal(drawn, torch.rand(4))
    for part in ("actor", "critic"):
        one, other = (getattr(learner.alg, part).state_dict() for learner in (ours.learner, theirs))
        assert all(torch.equal(value, other[name]) for name, value in one.items()), part
    assert ours.learner.alg.learning_rate == theirs.alg.learning_rate


@pytest.mark.parametrize("name", ["gamma", "lam", "clip_param", "value_loss_coef", "entropy_coef", "max_grad_norm"])
def test_every_number_of_the_agent_reaches_the_algorithm(task, tiny, name):
    trainer = make_trainer(task, tiny, f"--agent.{name.replace('_', '-')}", "0.123")
    assert getattr(trainer.learner.alg, name) == 0.123


def test_the_other_settings_of_the_agent_reach_the_algorithm(task, tiny):
    alg = make_trainer(task, tiny, "--agent.mixed-precision", "--agent.desired-kl", "0.02").learner.alg
    assert alg.use_mixed_precision
    assert (alg.desired_kl, alg.schedule) == (0.02, "adaptive")
    assert (alg.num_mini_batches, alg.num_learning_epochs) == (2, 1)
    assert alg.symmetry.use_data_augmentation
    assert make_trainer(task, tiny, "--agent.no-symmetry").learner.alg.symmetry is None


def test_the_schedule_is_fixed_only_while_the_actor_is_held(task, tiny):
    trainer = make_trainer(task, tiny, "--agent.critic-warmup-iterations", "2")
    schedules = []
    for _ in range(3):
        trainer.iterate()
        schedules.append(trainer.learner.alg.schedule)
    assert schedules == ["fixed", "fixed", "adaptive"]


def test_the_entropy_bonus_falls_linearly_until_the_last_iteration(task, tiny):
    trainer = make_trainer(task, tiny, "--agent.max-iterations", "3", "--agent.final-entropy-coef", "0.001")
    weights = []
    for _ in range(3):
        trainer.iterate()
        weights.append(trainer.learner.alg.entropy_coef)
    assert weights == pytest.approx([0.003, 0.002, 0.001], rel=1e-12)
