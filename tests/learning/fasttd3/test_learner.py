"""FastTD3 finds known values and the best action of a small problem, explores within bounds, and goes on as it was."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from humoslope.check.host_sync import NoHostSync
from humoslope.errors import UserError
from humoslope.learning.fasttd3 import learner as fasttd3_learner
from humoslope.learning.fasttd3.config import FastTd3Cfg
from humoslope.learning.fasttd3.learner import FastTd3, _half_mirrored
from humoslope.learning.learner import Transition
from humoslope.learning.policy import PolicySpec
from humoslope.learning.symmetry import Mirror
from humoslope.registry import build_task

PHASES, STEPS = 4, 6
BEST, BOUND, GAMMA = 0.5, 2.0, 0.8


class Wheel:
    """N wheels that turn by one of four phases a step. The last phase pays 4; actions cost their distance from `BEST`.

    An episode begins at the first phase. It ends after six steps by time, or at the end of the last phase by a fall.
    Everybody sees the phase and nothing else, so that a time-out is in a phase like any other.
    """

    device = torch.device("cpu")
    num_envs = 32

    def __init__(self, falls: bool = False) -> None:
        group = SimpleNamespace(shape=(PHASES,), history=1, term_shapes={"phase": (PHASES,)})
        self.observations = SimpleNamespace(groups={"actor": group, "critic": group})
        self.robot = SimpleNamespace(num_joints=1)
        self.falls = falls
        self.age = torch.randint(PHASES, (self.num_envs,))

    def get_observations(self) -> TensorDict:
        return self._seen(self.age)

    def _seen(self, age: Tensor) -> TensorDict:
        phase = torch.nn.functional.one_hot(age % PHASES, PHASES).to(torch.float32)
        return TensorDict({"actor": phase, "critic": phase}, batch_size=[self.num_envs])

    def step(self, obs: TensorDict, action: Tensor) -> Transition:
        phase = self.age % PHASES
        reward = 4.0 * (phase == PHASES - 1) - ((action[:, 0] - BEST) / BOUND).square()
        after = self.age + 1
        fell = (after % PHASES == 0) if self.falls else torch.zeros_like(after, dtype=torch.bool)
        late = (after == STEPS) & ~fell
        self.age = after.masked_fill(fell | late, 0)
        return Transition(obs, action, reward, fell, late, self._seen(self.age), self._seen(after))

    def values(self) -> list[float]:
        """Value of each phase under the best action."""
        round_ = 1.0 if self.falls else 1.0 - GAMMA**PHASES
        return [4.0 * GAMMA ** (PHASES - 1 - phase) / round_ for phase in range(PHASES)]


def small(**changes: Any) -> FastTd3Cfg:
    fields: dict[str, Any] = {
        **{"hidden_dims": (32,), "critic_hidden_dims": (64, 64), "num_atoms": 41, "v_min": -2.0, "v_max": 10.0},
        **{"action_bound": BOUND, "gamma": GAMMA, "n_step": 3, "num_updates": 4, "batch_size": 128},
        **{"learning_rate": 3e-3, "weight_decay": 0.0, "buffer_steps": 40, "num_steps_per_env": 8},
        **{"exploration_std": (0.05, 0.2), "mixed_precision": False},
    }
    return FastTd3Cfg(**fields | changes)


def drive(learner: FastTd3, world: Wheel, iterations: int) -> dict[str, float]:
    """What the training loop does; returns the last curves."""
    obs, curves = world.get_observations(), {}
    for iteration in range(iterations):
        learner.begin(iteration)
        with torch.inference_mode():
            for _ in range(learner.cfg.num_steps_per_env):
                transition = world.step(obs, learner.act(obs))
                learner.take(transition)
                obs = transition.next_obs
        curves = learner.update(obs)
    return curves


def values_of(learner: FastTd3, action: float) -> list[list[float]]:
    """What each critic expects at each phase."""
    seen = learner.normalizer(torch.eye(PHASES))
    logits = learner.critics(seen, torch.full((PHASES, 1), action / BOUND))
    return learner.support.mean(logits.softmax(dim=-1)).tolist()


def test_the_least_deviation_reaches_actor_and_critics() -> None:
    learner = FastTd3(Wheel(), small(least_obs_std=0.3))
    actor = learner.policy.get_submodule("obs_normalizer")
    assert [normaliser.least_std for normaliser in (actor, learner.normalizer)] == [0.3, 0.3]


@pytest.mark.parametrize(("falls", "clipped"), [(False, True), (True, False)])
def test_it_learns_the_known_values_and_the_best_action(falls: bool, clipped: bool) -> None:
    """Time-outs taken for falls, or followed by the next episode, would lower the first case's values by 1 to 3."""
    torch.manual_seed(0)
    world = Wheel(falls)
    learner = FastTd3(world, small(clipped_double_q=clipped))
    curves = drive(learner, world, 20)
    for critic in values_of(learner, BEST):
        assert critic == pytest.approx(world.values(), abs=0.25)
    actions = learner.policy({"actor": torch.eye(PHASES)})
    assert actions.squeeze(1).tolist() == pytest.approx([BEST] * PHASES, abs=0.2)
    assert curves["Value/end_atoms"] < 0.01
    assert learner.remarks() == []


def test_returns_beyond_the_support_are_a_curve_and_said_once() -> None:
    torch.manual_seed(0)
    world = Wheel()
    learner = FastTd3(world, small(v_max=3.0))
    curves = drive(learner, world, 4)
    assert curves["Value/end_atoms"] > 0.02
    (said,) = learner.remarks()
    assert "of the mass of their targets lies at -2 and 3" in said
    drive(learner, world, 1)
    assert learner.remarks() == []


def test_every_env_explores_with_a_strength_of_its_own_until_its_episode_ends() -> None:
    torch.manual_seed(0)
    world = Wheel(falls=True)
    learner = FastTd3(world, small(exploration_std=(0.1, 5.0)))
    obs, before = world.get_observations(), learner._exploration_std.clone()
    assert before.unique().numel() == world.num_envs
    with torch.inference_mode():
        actions = torch.stack([learner.act(obs) for _ in range(400)])  # [400, N, 1]
    assert actions.abs().max().item() == BOUND
    gentle, rough = before.argmin(), before.argmax()
    assert actions[:, gentle].std() < actions[:, rough].std()
    assert ((actions[:, rough].abs() == BOUND).to(torch.float32).mean()) > 0.5
    transition = world.step(obs, actions[0])
    learner.take(transition)
    assert torch.equal((learner._exploration_std != before).squeeze(1), transition.done)
    assert ((learner._exploration_std >= 0.1) & (learner._exploration_std <= 5.0)).all()


def test_nothing_is_learnt_before_enough_is_collected() -> None:
    world = Wheel()
    learner = FastTd3(world, small(learning_starts=20))
    before = copy.deepcopy(learner.critics.state_dict())
    assert drive(learner, world, 2) == {"Replay/steps": 16.0}
    assert all(torch.equal(value, learner.critics.state_dict()[name]) for name, value in before.items())
    assert drive(learner, world, 1).keys() >= {"Loss/critic", "Value/actor", "Policy/saturated"}


def test_the_actor_learns_in_every_second_update() -> None:
    torch.manual_seed(0)
    world = Wheel()
    learner = FastTd3(world, small(learning_starts=100))
    drive(learner, world, 2)
    moved = []
    for _ in range(4):
        before = learner.policy.mlp[0].weight.clone()
        learner._update_once()
        moved.append(not torch.equal(before, learner.policy.mlp[0].weight))
    assert moved == [False, True, False, True]


def test_a_run_goes_on_as_it_was_but_for_an_empty_buffer_which_it_says_and_fills_first() -> None:
    torch.manual_seed(0)
    world = Wheel()
    cfg = small(refill_steps=20)
    before = FastTd3(world, cfg)
    drive(before, world, 5)
    after = FastTd3(world, cfg)
    after.policy.load_state_dict(before.policy.state_dict())
    after.load_state_dict(copy.deepcopy(before.state_dict()))
    assert after.remarks() == [
        "A checkpoint does not hold the replay buffer: the actor first collects 20 new steps in every env, then it "
        "learns on."
    ]
    assert drive(after, world, 2) == {"Replay/steps": 16.0}
    assert "Loss/critic" in drive(after, world, 1)

    # With the same buffer, the same update follows, bit for bit.
    resumed = FastTd3(world, cfg)
    resumed.policy.load_state_dict(before.policy.state_dict())
    resumed.load_state_dict(copy.deepcopy(before.state_dict()))
    resumed.replay = before.replay
    for learner in (before, resumed):
        torch.manual_seed(7)
        learner._update_once()
        learner._update_once()
    for name, value in before.critics.state_dict().items():
        assert torch.equal(value, resumed.critics.state_dict()[name])
    for name, value in before.policy.state_dict().items():
        assert torch.equal(value, resumed.policy.state_dict()[name])


def test_a_run_that_is_stopped_while_it_fills_its_buffer_fills_it_again() -> None:
    world = Wheel()
    before = FastTd3(world, small(refill_steps=20))
    drive(before, world, 5)
    stopped = FastTd3(world, before.cfg)
    stopped.load_state_dict(before.state_dict())
    drive(stopped, world, 1)
    again = FastTd3(world, before.cfg)
    again.load_state_dict(stopped.state_dict())
    assert "first collects 20 new steps" in again.remarks()[0]


def test_neither_steps_nor_updates_wait_for_the_device() -> None:
    world = Wheel()
    learner = FastTd3(world, small())
    drive(learner, world, 2)
    obs = world.get_observations()
    with torch.inference_mode():
        transition = world.step(obs, learner.act(obs))
        with NoHostSync():
            learner.act(obs)
            learner.take(transition)
    with NoHostSync():
        for _ in range(2):
            learner._update_once()


@contextmanager
def group_of_one() -> Iterator[None]:
    torch.distributed.init_process_group("gloo", store=torch.distributed.HashStore(), rank=0, world_size=1)
    try:
        yield
    finally:
        torch.distributed.destroy_process_group()


def test_processes_learn_with_the_mean_of_their_gradients() -> None:
    """In a group of one, what they do to share weights, means and gradients must change nothing."""
    weights = []
    for size in (0, 1):
        torch.manual_seed(0)
        world = Wheel()
        learner = FastTd3(world, small())
        with group_of_one() if size else nullcontext():
            if size:
                learner.synchronise()
            drive(learner, world, 3)
        weights.append(
            torch.cat([p.detach().flatten() for p in (*learner.policy.parameters(), *learner.critics.parameters())])
        )
    assert torch.allclose(*weights, atol=1e-3)


def test_every_gradient_is_shared_and_every_weight_comes_from_the_first_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where the mean of all gradients is 0 nothing moves, whatever this process has found."""
    torch.manual_seed(0)
    world = Wheel()
    learner = FastTd3(world, small(learning_starts=8, num_steps_per_env=8, num_updates=1))
    before = [copy.deepcopy(network.state_dict()) for network in (learner.policy.mlp, learner.critics)]
    sent: list[int] = []
    monkeypatch.setattr(torch.distributed, "broadcast", lambda tensor, src: sent.append(tensor.data_ptr()))
    monkeypatch.setattr(fasttd3_learner, "mean_over_processes", torch.zeros_like)
    with group_of_one():
        drive(learner, world, 1)
    for network, state in zip((learner.policy.mlp, learner.critics), before, strict=True):
        assert all(torch.equal(value, state[name]) for name, value in network.state_dict().items())
    learner.synchronise()
    networks = (learner.policy, learner.critics, learner.targets, learner.normalizer)
    assert sent == [tensor.data_ptr() for network in networks for tensor in network.state_dict().values()]


def test_half_of_a_batch_is_mirrored(make_stage1: Callable[..., Any]) -> None:
    env = make_stage1(2)
    env.enable_terminal_observations()
    cfg = small(hidden_dims=(8,), critic_hidden_dims=(8,), batch_size=4, symmetry=True, half_precision_replay=False)
    learner = FastTd3(env, cfg)
    obs = env.get_observations()
    with torch.inference_mode():
        for _ in range(3):
            action = learner.act(obs)
            following, reward, fell, late = env.step(action)
            learner.take(Transition(obs, action, reward, fell, late, following, env.terminal_observations))
            obs = following
    batch = learner.replay.draw(4, 2, GAMMA)
    plain = batch._replace(
        action=batch.action.clone(),
        obs={name: values.clone() for name, values in batch.obs.items()},
        next_obs={name: values.clone() for name, values in batch.next_obs.items()},
    )
    mirror = Mirror(env)
    mirrored = _half_mirrored(batch, mirror)
    assert torch.equal(mirrored.action, torch.cat([mirror.action(plain.action[:2]), plain.action[2:]]))
    for now, before in ((mirrored.obs, plain.obs), (mirrored.next_obs, plain.next_obs)):
        image = mirror.observation(TensorDict(before, batch_size=[4]))
        for name in ("actor", "critic"):
            assert torch.equal(now[name], torch.cat([image[name][:2], before[name][2:]]))
    learner._update_once()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"gamma": 1.0}, r"agent\.gamma is 1; it must be between 0 and 1, 1 excluded \(too high\)\."),
        ({"v_min": 3.0, "v_max": 3.0}, "agent.v_min 3 must be less than v_max 3."),
        ({"num_atoms": 1}, r"agent\.num_atoms is 1; it must be 2 or more \(too low\)\."),
        ({"exploration_std": (0.3, 0.1)}, r"agent\.exploration_std is \(0\.3, 0\.1\); it must be \(lowest, highest\)"),
        ({"critic_hidden_dims": ()}, r"agent.critic_hidden_dims is \(\); it must have at least one\.$"),
        ({"batch_size": 0}, r"agent\.batch_size is 0; it must be 1 or more \(too low\)\."),
    ],
)
def test_impossible_values_are_refused(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said):
        small(**changes).check()


def test_a_buffer_shorter_than_a_window_is_refused() -> None:
    with pytest.raises(UserError, match="agent.buffer_steps 4 must be more than 4: the frames of a history, and"):
        FastTd3(Wheel(), small(buffer_steps=4))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"batch_size": 1_000_000}, "agent.batch_size is 1,000,000, which needs"),
        ({"num_atoms": 1_000_000}, "the number of a critic's weights is"),
        ({"hidden_dims": (16_384, 16_384)}, "the number of the actor's weights is 268,"),
    ],
)
def test_what_memory_does_not_hold_is_refused_before_it_is_built(
    monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any], said: str
) -> None:
    monkeypatch.setattr("humoslope.memory.available", lambda: 50_000_000)
    monkeypatch.setattr(PolicySpec, "build", None)
    with pytest.raises(UserError, match=f"{said}.* GiB are free, enough for [1-9]"):
        FastTd3(Wheel(), small(**changes))


def test_presets_are_those_of_the_authors_and_a_smaller_one() -> None:
    agent = build_task("FastTD3-IsaacLab-Unitree-G1").agent
    assert isinstance(agent, FastTd3Cfg)
    agent.scale_to("gpu")
    assert (agent.num_atoms, agent.gamma, agent.n_step, agent.num_updates, agent.batch_size) == (251, 0.99, 8, 4, 32768)
    assert (agent.hidden_dims, agent.critic_hidden_dims) == ((512, 256, 128), (1024, 512, 256))
    agent.scale_to("cpu")
    assert (agent.num_atoms, agent.gamma, agent.n_step, agent.num_updates, agent.batch_size) == (101, 0.97, 8, 2, 2048)
    assert (agent.hidden_dims, agent.critic_hidden_dims) == ((256, 128, 64), (512, 256, 128))
    agent.check()
