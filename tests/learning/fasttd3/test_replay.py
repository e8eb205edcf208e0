"""What is drawn from the ring is what happened: windows over falls, time-outs and the ring's seam, and histories."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tensordict import TensorDict

from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.learning.fasttd3 import replay as module
from humoslope.learning.fasttd3.replay import FrameLayout, Replay

CPU = torch.device("cpu")
GAMMA = 0.5
WIDE = SimpleNamespace(shape=(9,), history=3, term_shapes={"one": (1,), "two": (2,)})
"""A group of two terms over three steps: one, one, one, two, two, two."""
PLAIN = SimpleNamespace(shape=(2,), history=1, term_shapes={"two": (2,)})


def layouts() -> dict[str, FrameLayout]:
    return {name: FrameLayout.of(name, group, CPU) for name, group in (("wide", WIDE), ("plain", PLAIN))}


@dataclass
class Episode:
    """An episode as it was seen: one more frame than actions, and how it ended ("" while it goes on)."""

    frames: list[float] = field(default_factory=list)
    actions: list[float] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    end: str = ""

    def observed(self, step: int) -> dict[str, list[float]]:
        one = [self.frames[max(0, step - back)] for back in (2, 1, 0)]
        two = [number for frame in one for number in (frame + 0.25, frame + 0.5)]
        return {"wide": one + two, "plain": two[-2:]}

    def window(self, step: int, n_step: int) -> tuple[float, float, dict[str, list[float]]]:
        """Reward, discount and what is seen afterwards."""
        length = min(n_step, len(self.actions) - step)
        reward = sum(GAMMA**i * self.rewards[step + i] for i in range(length))
        fell = self.end == "fall" and step + length == len(self.actions)
        return reward, 0.0 if fell else GAMMA**length, self.observed(step + length)


class Story:
    """Random episodes of some envs, told to a replay buffer and written down."""

    def __init__(self, num_envs: int, steps: int, dtype: torch.dtype = torch.float32) -> None:
        self.replay = Replay(layouts(), num_envs, 1, steps, dtype, CPU)
        self.told: list[list[Episode]] = [[] for _ in range(num_envs)]
        self.numbers = 0.0
        self.start(range(num_envs))

    def start(self, envs: object) -> None:
        for env in envs:  # type: ignore[attr-defined]
            self.told[env].append(Episode(frames=[self.number()]))

    def number(self) -> float:
        """A number that no other frame, action or reward has."""
        self.numbers += 1.0
        return self.numbers

    def step(self, ends: list[str]) -> None:
        now = [episodes[-1] for episodes in self.told]
        obs = self.as_obs(now)
        for episode, end in zip(now, ends, strict=True):
            episode.actions.append(self.number())
            episode.rewards.append(self.number())
            episode.frames.append(self.number())
            episode.end = end
        self.replay.add(
            obs,
            torch.tensor([[episode.actions[-1]] for episode in now]),
            torch.tensor([episode.rewards[-1] for episode in now]),
            torch.tensor([end == "fall" for end in ends]),
            torch.tensor([end != "" for end in ends]),  # a fall at the time limit is a fall
            self.as_obs(now),
        )
        self.start([env for env, end in enumerate(ends) if end])

    def as_obs(self, episodes: list[Episode]) -> TensorDict:
        seen = [episode.observed(len(episode.frames) - 1) for episode in episodes]
        groups = {name: torch.tensor([one[name] for one in seen]) for name in ("wide", "plain")}
        return TensorDict(groups, batch_size=[len(episodes)])

    def by_action(self) -> dict[float, tuple[Episode, int]]:
        """Episode and step of every action."""
        return {a: (e, i) for episodes in self.told for e in episodes for i, a in enumerate(e.actions)}


@given(st.integers(0, 10**6), st.sampled_from([1, 5, 9, 23, 40]), st.integers(1, 5), st.sampled_from([10, 11, 80]))
def test_every_window_that_is_drawn_is_one_that_happened(seed: int, length: int, n_step: int, steps: int) -> None:
    chance = random.Random(seed)
    told = Story(2, steps)
    cut_at = chance.randrange(40)
    for number in range(length):
        if number == cut_at:  # the envs have gone on elsewhere
            told.replay.cut()
            for episodes in told.told:
                episodes[-1].end = episodes[-1].end or "time"
            told.start([0, 1])
        told.step(chance.choices(["", "fall", "time"], [6, 1, 2], k=2))
    happened = told.by_action()
    torch.manual_seed(0)
    batch = told.replay.draw(100, n_step, GAMMA)
    for row in range(100):
        episode, step = happened[batch.action[row].item()]
        reward, discount, after = episode.window(step, n_step)
        assert batch.reward[row].item() == pytest.approx(reward)
        assert batch.discount[row].item() == pytest.approx(discount)
        for name, expected in episode.observed(step).items():
            assert batch.obs[name][row].tolist() == expected
        if discount:
            for name, expected in after.items():
                assert batch.next_obs[name][row].tolist() == expected


@pytest.mark.parametrize("steps", [10, 100])
def test_every_step_that_is_held_is_drawn(steps: int) -> None:
    told = Story(2, steps)
    for number in range(37):
        told.step(["time" if number % 7 == 6 else "", "fall" if number % 5 == 4 else ""])
    torch.manual_seed(0)
    drawn = set(told.replay.draw(4000, 3, GAMMA).action.squeeze(1).tolist())
    for episodes in told.told:
        actions = [action for episode in episodes for action in episode.actions]
        # All but the newest frame, the oldest ones that histories need, and those in which episodes were cut off.
        least = 37 if steps == 100 else steps - 1 - 3 - 2
        assert set(actions[-least:]) <= drawn
        if steps == 10:
            assert not set(actions[:-steps]) & drawn


def test_the_last_step_before_a_time_out_leads_to_the_state_in_which_the_episode_ended() -> None:
    told = Story(1, 20)
    for end in ("", "", "time", ""):
        told.step([end])
    first, second = told.told[0][0], told.told[0][1]
    zero = torch.zeros(1, dtype=torch.int64)
    window = told.replay.windows(zero, zero + 1, 5, GAMMA)
    assert window.reward.item() == first.rewards[1] + GAMMA * first.rewards[2]
    assert window.discount.item() == GAMMA**2
    assert window.next_obs["plain"].tolist() == [first.observed(3)["plain"]]
    # The frame after it belongs to the next episode, whose history begins anew.
    assert told.replay.observations(zero, zero + 4)["wide"].tolist() == [second.observed(0)["wide"]]


def test_half_precision_rounds_and_keeps_what_is_too_large_as_its_largest_number() -> None:
    told = Story(1, 10, torch.float16)
    told.numbers = 1e6
    told.told[0][-1].frames = [0.1]
    told.step([""])
    batch = told.replay.draw(1, 1, GAMMA)
    assert batch.obs["wide"][0, 2].item() == pytest.approx(0.1, rel=1e-3)
    assert batch.action.item() == 65504.0
    assert batch.reward.item() == 1_000_002.0  # rewards are kept as they are


def test_rebuilt_histories_are_those_that_the_environment_showed(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    def short(cfg: EnvCfg) -> None:
        cfg.episode_length_s = 0.14

    env = make_stage1(4, short)
    env.enable_terminal_observations()
    names = ("actor", "critic")
    made = {name: FrameLayout.of(name, env.observations.groups[name], CPU) for name in names}
    replay = Replay(made, 4, 29, 100, torch.float32, CPU)
    seen: list[list[TensorDict]] = [[] for _ in range(4)]
    env.episode_length_buf = torch.tensor([0, 2, 4, 5])
    obs = env.get_observations()
    for _ in range(20):
        action = 0.3 * torch.randn(4, 29)
        following, reward, terminated, time_outs = env.step(action)
        terminal = env.terminal_observations
        replay.add(obs, action, reward, terminated, time_outs, terminal)
        for one in range(4):
            seen[one].append(obs[one])
            if time_outs[one] and not terminated[one]:
                seen[one].append(terminal[one])
        obs = following
    assert sum(len(one) for one in seen) > 80 + 8  # episodes ended
    for one in range(4):
        frames = torch.arange(len(seen[one]))
        rebuilt = replay.observations(torch.full_like(frames, one), frames)
        for name in names:
            assert torch.equal(rebuilt[name], torch.stack([observed[name] for observed in seen[one]]))


def test_a_buffer_larger_than_memory_is_refused_with_the_size_that_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    per_step = 2 * (4 * (3 + 2 + 1) + 8)  # two envs; frames and action in single precision, and 8 bytes beside them
    monkeypatch.setattr(module, "free_memory", lambda device: 1000 * per_step)
    monkeypatch.setattr(module.torch, "zeros", None)  # nothing is allocated before it is refused
    said = r"agent.buffer_steps 1001 takes 0.0 GB for 2 envs, but only 0.0 GB are free on cpu; at most 900 steps fit\."
    with pytest.raises(UserError, match=said):
        Replay(layouts(), 2, 1, 1001, torch.float32, CPU)
    monkeypatch.undo()
    monkeypatch.setattr(module, "free_memory", lambda device: 1000 * per_step)
    Replay(layouts(), 2, 1, 900, torch.float32, CPU)


def test_groups_that_are_no_vectors_are_refused() -> None:
    image = SimpleNamespace(shape=(1, 7, 7), history=1, term_shapes={"scan": (1, 7, 7)})
    with pytest.raises(UserError, match="observation group 'ground' is no vector"):
        FrameLayout.of("ground", image, CPU)
