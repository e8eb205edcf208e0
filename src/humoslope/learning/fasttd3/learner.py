"""FastTD3 as a learner: exploring, remembering, and the updates of critics and actor."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from contextlib import contextmanager
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from humoslope.errors import UserError
from humoslope.learning.distributed import mean_over_processes
from humoslope.learning.fasttd3.networks import Critics, Support
from humoslope.learning.fasttd3.replay import Batch, FrameLayout, Replay
from humoslope.learning.learner import Transition
from humoslope.learning.networks import Normalisation
from humoslope.learning.policy import PolicySpec, shapes_of
from humoslope.learning.symmetry import Mirror, apply
from humoslope.memory import require_memory

if TYPE_CHECKING:
    from collections.abc import Iterator

    from humoslope.env import ManagerBasedRlEnv
    from humoslope.learning.fasttd3.config import FastTd3Cfg

ACTOR, CRITIC = "actor", "critic"
"""Observation groups that the two kinds of network read."""

END_MASS = 0.02
"""Mean mass of targets in the end atoms of the support from which the returns count as leaving it."""
SATURATED = 0.95
"""Share of the action bound from which an action counts as saturated."""


class FastTd3:
    """FastTD3 for an environment.

    As the authors' code has it: a deterministic actor without a target network; two critics that give distributions
    over returns, and their slow copies as targets; n-step returns; exploration noise of its own strength in every env.
    Different here:

    - The loop takes a whole rollout before it updates, so the updates of its steps come in one go.
    - Time-outs are bootstrapped from the observation in which the episode ended, not from the next episode's first one.
    - Noisy actions are clamped before they are executed and remembered, so that the critics judge what was done.
    - Means and deviations of observations are learnt from each new observation once, not from replayed ones.
    - Of two target critics the one that expects less is chosen before its distribution is moved and projected, not
      after: the same unless returns leave the support.

    The replay buffer is not in checkpoints, as it is many times as large as the networks (half a gigabyte in the `cpu`
    preset). A resumed run has the networks, their slow copies, the optimisers and all normalisation exactly as they
    were, begins with an empty buffer, and collects `refill_steps` with its actor before it learns on.

    Raises:
        UserError: If the configuration does not fit the environment or the memory.
    """

    wants_terminal_obs = True

    def __init__(self, env: ManagerBasedRlEnv, cfg: FastTd3Cfg) -> None:
        self.cfg, self._device = cfg, env.device
        self.spec = PolicySpec.of(env, "tanh-mlp", (ACTOR,), _actor_settings(cfg))
        ((seen,), (num_obs,)), num_actions = shapes_of(env, (ACTOR, CRITIC)), self.spec.num_actions
        _require_room(env, cfg, seen, num_obs, num_actions)
        self.policy = self.spec.build(env.device)
        self.critics = Critics(num_obs, num_actions, cfg.critic_hidden_dims, cfg.num_atoms).to(env.device)
        self.targets = copy.deepcopy(self.critics).requires_grad_(False)
        self.normalizer = Normalisation(num_obs, cfg.least_obs_std).to(env.device)  # of the critics' observations
        self.support = Support.of(cfg.v_min, cfg.v_max, cfg.num_atoms, env.device)
        self.replay = _make_replay(env, cfg, num_actions)
        self._mirror = Mirror(env) if cfg.symmetry else None
        self._actor_optimizer, self._critic_optimizer = (
            torch.optim.AdamW(network.parameters(), lr=cfg.learning_rate, weight_decay=cfg.weight_decay, fused=True)
            for network in (self.policy, self.critics)
        )
        self._exploration_std = self._drawn_std(env.num_envs)
        self._next_obs: TensorDict | None = None  # what the next step must begin with
        self._updates = 0  # of the critics
        self._collect_first = cfg.learning_starts  # control steps in the buffer before learning begins
        self._remarks: list[str] = []
        self._warned = False

    def begin(self, iteration: int) -> None:
        """Nothing to prepare."""

    def act(self, obs: TensorDict) -> Tensor:
        """The actor's action with noise, within the bound, [N, J]."""
        action = self._share_of_bound(obs)
        noise = self._exploration_std * torch.randn_like(action)
        return (action + noise).clamp(-1.0, 1.0) * self.cfg.action_bound

    def take(self, transition: Transition) -> None:
        """Remembers a step, and learns mean and deviation of its observations."""
        assert transition.terminal_obs is not None
        if transition.obs is not self._next_obs:
            self.replay.cut()
        self.replay.add(
            transition.obs,
            transition.action / self.cfg.action_bound,
            transition.reward,
            transition.terminated,
            transition.time_outs,
            transition.terminal_obs,
        )
        self._next_obs = transition.next_obs
        self.policy.update_normalization(transition.obs)  # type: ignore[operator]
        self.normalizer.update(transition.obs[CRITIC])
        fresh = self._drawn_std(len(transition.reward))
        self._exploration_std = torch.where(transition.done[:, None], fresh, self._exploration_std)

    def update(self, obs: TensorDict) -> dict[str, float]:
        """The updates of all steps of the rollout; none as long as the buffer holds too little."""
        cfg, held = self.cfg, min(self.replay.collected, self.cfg.buffer_steps)
        curves: dict[str, list[Tensor]] = {}
        if self.replay.collected >= self._collect_first:
            for _ in range(cfg.num_steps_per_env * cfg.num_updates):
                values = self._update_once()
                for name, value in values.items():
                    curves.setdefault(name, []).append(value)
        names = list(curves)
        means = torch.stack([torch.stack(curves[name]).mean() for name in names]).tolist() if names else []
        logged = dict(zip(names, means, strict=True))
        self._watch_support(logged.get("Value/end_atoms", 0.0))
        return {**logged, "Replay/steps": float(held)}

    def synchronise(self) -> None:
        """Gives every process the weights of the first one."""
        for network in (self.policy, self.critics, self.targets, self.normalizer):
            for tensor in network.state_dict().values():
                torch.distributed.broadcast(tensor, src=0)

    def remarks(self) -> list[str]:
        """Sentences for the user since the last call."""
        remarks, self._remarks = self._remarks, []
        return remarks

    def state_dict(self) -> dict[str, Any]:
        """Critics, their slow copies, normalisation and optimisers; not the replay buffer."""
        return {
            **{name: part.state_dict() for name, part in self._parts().items()},
            "updates": self._updates,
            "collected": max(min(self.replay.collected, self.cfg.buffer_steps), self._collect_first),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict` with an empty replay buffer."""
        for name, part in self._parts().items():
            part.load_state_dict(state[name])
        self._updates = state["updates"]
        self._collect_first = max(self.cfg.learning_starts, min(state["collected"], self.cfg.refill_steps))
        self._remarks.append(
            "A checkpoint does not hold the replay buffer: the actor first collects "
            f"{self._collect_first} new steps in every env, then it learns on."
        )

    def _parts(self) -> dict[str, Any]:
        """What a checkpoint holds beside the policy."""
        return {
            "critics": self.critics,
            "targets": self.targets,
            "normalizer": self.normalizer,
            "actor_optimizer": self._actor_optimizer,
            "critic_optimizer": self._critic_optimizer,
        }

    def _update_once(self) -> dict[str, Tensor]:
        batch = self.replay.draw(self.cfg.batch_size, self.cfg.n_step, self.cfg.gamma)
        if self._mirror is not None:
            batch = _half_mirrored(batch, self._mirror)
        values = self._update_critics(batch)
        self._updates += 1
        if self._updates % self.cfg.policy_frequency == 0:
            values |= self._update_actor(batch)
        with torch.no_grad():
            for slow, fast in zip(self.targets.parameters(), self.critics.parameters(), strict=True):
                slow.lerp_(fast, self.cfg.tau)
        return values

    def _update_critics(self, batch: Batch) -> dict[str, Tensor]:
        """Moves the critics' distributions towards those of reward and discounted value of the next action."""
        target = self._target(batch)
        with self._precision():
            logits = self.critics(self.normalizer(batch.obs[CRITIC]), batch.action)
        log_probabilities = logits.float().log_softmax(dim=-1)  # [2, B, A]
        loss = -(target * log_probabilities).sum(dim=-1).mean(dim=1).sum()
        _step(self._critic_optimizer, loss, self.critics.parameters())
        value = self.support.mean(log_probabilities.detach().exp()).mean()
        return {"Loss/critic": loss.detach(), "Value/mean": value, "Value/end_atoms": self.support.end_mass(target)}

    @torch.no_grad()
    def _target(self, batch: Batch) -> Tensor:
        """Distributions [1 or 2, B, A] that the critics are to give: one for both, or one for each."""
        cfg = self.cfg
        with self._precision():
            action = self._share_of_bound(batch.next_obs)
            noise = (cfg.target_noise * torch.randn_like(action)).clamp(-cfg.target_noise_clip, cfg.target_noise_clip)
            action = (action + noise).clamp(-1.0, 1.0)
            logits = self.targets(self.normalizer(batch.next_obs[CRITIC]), action)
        following = logits.float().softmax(dim=-1)  # [2, B, A]
        if cfg.clipped_double_q:
            first, second = self.support.mean(following)
            following = torch.where((first < second)[:, None], following[0], following[1])[None]
        return self.support.project(following, batch.reward, batch.discount)

    def _update_actor(self, batch: Batch) -> dict[str, Tensor]:
        """Moves the actor towards actions from which the critics expect more."""
        self.critics.requires_grad_(False)
        with self._precision():
            action = self._share_of_bound(batch.obs)
            logits = self.critics(self.normalizer(batch.obs[CRITIC]), action)
        self.critics.requires_grad_(True)
        values = self.support.mean(logits.float().softmax(dim=-1))  # [2, B]
        value = values.amin(dim=0) if self.cfg.clipped_double_q else values.mean(dim=0)
        _step(self._actor_optimizer, -value.mean(), self.policy.parameters())
        saturated = (action.detach().abs() > SATURATED).to(torch.float32).mean()
        return {"Value/actor": value.detach().mean(), "Policy/saturated": saturated}

    def _share_of_bound(self, obs: Any) -> Tensor:
        """The actor's action, in [-1, 1]."""
        action: Tensor = self.policy(obs)
        return action.float() / self.cfg.action_bound

    def _drawn_std(self, num_envs: int) -> Tensor:
        """A standard deviation of the exploration noise for each env, [N, 1]."""
        return torch.empty(num_envs, 1, device=self._device).uniform_(*self.cfg.exploration_std)

    @contextmanager
    def _precision(self) -> Iterator[None]:
        """Lets networks multiply in bfloat16 while inside, if the configuration says so."""
        with torch.autocast(self._device.type, torch.bfloat16, enabled=self.cfg.mixed_precision):
            yield

    def _watch_support(self, end_mass: float) -> None:
        if end_mass > END_MASS and not self._warned:
            self._warned = True
            cfg = self.cfg
            self._remarks.append(
                f"The returns leave what the critics can express: {100.0 * end_mass:.0f} % of the mass of their "
                f"targets lies at {cfg.v_min:g} and {cfg.v_max:g}; begin a run with a lower --agent.v-min or a higher "
                "--agent.v-max."
            )


def _actor_settings(cfg: FastTd3Cfg) -> dict[str, Any]:
    return {
        "bound": cfg.action_bound,
        "hidden_dims": list(cfg.hidden_dims),
        "activation": "relu",
        "obs_normalization": True,
        "least_std": cfg.least_obs_std,
    }


def _make_replay(env: ManagerBasedRlEnv, cfg: FastTd3Cfg, num_actions: int) -> Replay:
    groups = env.observations.groups
    layouts = {name: FrameLayout.of(name, groups[name], env.device) for name in (ACTOR, CRITIC)}
    least = max(layout.history for layout in layouts.values()) + cfg.n_step
    if cfg.buffer_steps <= least:
        raise UserError(
            f"agent.buffer_steps {cfg.buffer_steps} must be more than {least}: the frames of a history, and the steps "
            "of a return."
        )
    dtype = torch.float16 if cfg.half_precision_replay else torch.float32
    return Replay(layouts, env.num_envs, num_actions, cfg.buffer_steps, dtype, env.device)


def _require_room(env: ManagerBasedRlEnv, cfg: FastTd3Cfg, seen: int, num_obs: int, num_actions: int) -> None:
    """Raises UserError unless the networks and a batch fit into the free memory, by low estimates.

    Args:
        seen, num_obs: Sizes of the observations of actor and critics.
    """
    actor, critic = (
        sum(a * b for a, b in pairwise(dims))
        for dims in (
            (seen, *cfg.hidden_dims, num_actions),
            (num_obs + num_actions, *cfg.critic_hidden_dims, cfg.num_atoms),
        )
    )
    # With gradients and two moments of AdamW, in single precision; of two critics slow copies as well.
    require_memory("the number of the actor's weights", actor, 4 * 4, device=env.device)
    require_memory("the number of a critic's weights", critic, (2 * 4 + 2) * 4, device=env.device)
    # Observations of both ends, rows of a window's steps, what both critics' layers keep for their gradients, and four
    # distributions of each while they are projected.
    widths = 2 * (seen + num_obs) + 2 * sum(cfg.critic_hidden_dims) + 8 * cfg.num_atoms
    each = 4 * widths + 8 * 3 * cfg.n_step
    more = f" with {cfg.num_atoms} atoms and returns of {cfg.n_step} steps"
    require_memory("agent.batch_size", cfg.batch_size, each, more, env.device)


def _half_mirrored(batch: Batch, mirror: Mirror) -> Batch:
    """The batch with the first half of it in the mirror; its order is random."""
    half = len(batch.reward) // 2
    for obs in (batch.obs, batch.next_obs):
        for name, values in obs.items():
            values[:half] = apply(mirror.groups[name], values[:half])
    batch.action[:half] = apply(mirror.actions, batch.action[:half])
    return batch


def _step(optimizer: torch.optim.Optimizer, loss: Tensor, parameters: Iterable[nn.Parameter]) -> None:
    """One step down the gradient of the loss, the mean of those of all processes."""
    optimizer.zero_grad()
    loss.backward()
    if torch.distributed.is_initialized():
        gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
        vector_to_parameters(mean_over_processes(parameters_to_vector(gradients)), gradients)
    optimizer.step()
