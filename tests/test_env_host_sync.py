"""A step never waits for the device; what a GPU would wait for is refused here, on the CPU, which never does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from humoslope.check.host_sync import HostSync, NoHostSync, no_host_sync
from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.managers import EventTermCfg, ObservationTermCfg, RewardTermCfg, TermCfg
from humoslope.mdp import bsga, events, gallant, observations
from humoslope.mdp.bsga_memory import SlopeGait
from humoslope.slope.descriptor import phi5


@pytest.mark.parametrize("terminal", [False, True])
def test_a_step_never_waits_for_the_device_whatever_happens_in_it(
    make_stage1: Callable[..., ManagerBasedRlEnv], monkeypatch: pytest.MonkeyPatch, terminal: bool
) -> None:
    def change(cfg: EnvCfg) -> None:
        cfg.observations.critic.terms.terrain_descriptor = ObservationTermCfg(observations.terrain_descriptor)
        cfg.observers.slope_gait = TermCfg(SlopeGait)
        cfg.events.com = EventTermCfg(events.randomize_com, {"body": "torso_link", "offset": 0.02})  # at resets
        cfg.rewards.head_height = RewardTermCfg(gallant.head_height, {"target": 1.2})
        cfg.rewards.com_height = RewardTermCfg(bsga.ComHeight, {"nominal": 0.69})
        cfg.rewards.hip = RewardTermCfg(bsga.HipPropulsion)
        cfg.rewards.brake = RewardTermCfg(bsga.KneeBraking)
        cfg.rewards.stride = RewardTermCfg(bsga.Stride)
        cfg.rewards.swing = RewardTermCfg(bsga.SwingHip, {"beta0": 0.45, "beta1": 1.0, "theta_clip": 0.5})

    env = make_stage1(16, change)
    if terminal:
        env.enable_terminal_observations()
    actions = [0.3 * torch.randn(16, 29) for _ in range(20)]
    for action in actions[:12]:
        env.step(action)
    env.log.flush()
    env.events["harness"].strictness = torch.tensor(1.0)  # all levels are open
    late, climbed, fallen, broken, pushed, asked = (~env.tiles.omnidirectional).nonzero().flatten()[:6].tolist()
    env.episode_length_buf[[late, climbed]] = env.max_episode_length - 1
    qpos, qvel = env.sim.state("qpos"), env.sim.state("qvel")
    qpos[climbed, 0] += 8.2
    qpos[fallen, 3:7] = torch.tensor([0.5, 0.5, 0.5, 0.5])
    qvel[broken, 10] = torch.nan
    env.events._steps_left["push"][pushed] = 1.0
    env.commands._steps_left[asked] = 1.0
    env.commands._stands[asked] = False
    command = env.commands.velocity[asked].clone()

    with no_host_sync(env):
        _, _, failed, ended = env.step(actions[12])
        for action in actions[13:]:
            obs, reward, _, _ = env.step(action)

    # All of it happened.
    assert ended.nonzero().flatten().tolist() == [late, climbed]
    assert failed.nonzero().flatten().tolist() == [fallen, broken]
    assert env.tiles.level.nonzero().flatten().tolist() == [climbed]
    assert env.events._steps_left["push"][pushed] > 200.0
    assert env.commands.velocity[asked, 0] != command[0]
    assert env.log.flush()["Train/diverged"] > 0.0
    assert env.take_divergence() is not None
    assert env.non_finite() == []
    assert reward.isfinite().all()
    assert obs["actor"].isfinite().all()
    assert env.height_scan.descriptor.valid.all()
    assert obs["critic"][:, -5:].equal(phi5(env.height_scan.descriptor))


X = torch.arange(4.0)
CHOSEN = X > 1.0

WAITS: dict[str, Callable[[Tensor], Any]] = {
    "item": lambda x: x.sum().item(),
    "float": lambda x: float(x[0]),
    "truth": lambda x: bool(CHOSEN.any()),
    "nonzero": lambda x: CHOSEN.nonzero(),
    "where": lambda x: torch.where(CHOSEN),
    "mask": lambda x: x[CHOSEN],
    "masked_write": lambda x: x.clone().__setitem__(CHOSEN, 0.0),
    "masked_select": lambda x: x.masked_select(CHOSEN),
    "unique": lambda x: x.unique(),
    "consecutive": lambda x: x.unique_consecutive(),
    "solve": lambda x: torch.linalg.solve(torch.eye(4), x),
    "alike": lambda x: x.new_tensor([1.0, 2.0]),
    "equal": lambda x: x.equal(x),
    "repeat": lambda x: x.repeat_interleave(x.long()),
    "list": lambda x: x.tolist(),
    "numpy": lambda x: x.numpy(),
    "cpu": lambda x: x.cpu(),
    "new": lambda x: torch.tensor([1.0, 2.0]),
    "away": lambda x: x.to("meta"),
    "index_by_list": lambda x: x[[0, 2]],
    "column_by_tuple": lambda x: x[None, :][:, (0, 2)],
    "write_by_array": lambda x: x.clone().__setitem__(np.array([0, 2]), 0.0),
}


@pytest.mark.parametrize("name", WAITS)
def test_the_guard_refuses_what_waits(name: str) -> None:
    with pytest.raises(HostSync), NoHostSync():
        WAITS[name](X)


def test_the_guard_lets_through_what_does_not_wait() -> None:
    with NoHostSync():
        y = torch.where(CHOSEN, 0.0, X).masked_fill(CHOSEN, 1.0) + torch.full((), 2.0)
        y = y[torch.arange(3)].to(torch.float64).clamp(min=0.0)
        y[1:] = 0.0
    assert y.shape == (3,)
