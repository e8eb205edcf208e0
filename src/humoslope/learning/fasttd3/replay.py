"""Replay buffer: a ring of single frames for each env, from which histories and n-step returns are made when drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor

from humoslope.errors import UserError
from humoslope.managers.observation import ObservationGroup
from humoslope.memory import free_memory

SHARE_OF_FREE = 0.9
"""Share of the free memory that a buffer may take."""


class Batch(NamedTuple):
    """Transitions over up to n steps.

    Attributes:
        obs: Observations [B, d] by group.
        action: [B, J] in [-1, 1].
        reward: [B] discounted sum of the rewards of the steps.
        discount: [B] factor on the value of what follows; 0 where the robot fell.
        next_obs: Observations [B, d] after these steps, by group.
    """

    obs: dict[str, Tensor]
    action: Tensor
    reward: Tensor
    discount: Tensor
    next_obs: dict[str, Tensor]


@dataclass(frozen=True)
class FrameLayout:
    """The arrangement of single frames in the observation of a group.

    Attributes:
        history: Number of frames H in an observation.
        newest: [D] columns of an observation that are its newest frame.
        stacking: [H * D] place, among the frames one after the other, oldest first, of each column of an observation.
    """

    history: int
    newest: Tensor
    stacking: Tensor

    @classmethod
    def of(cls, name: str, group: ObservationGroup, device: torch.device) -> FrameLayout:
        """The layout of a group of the environment, whose terms keep their frames together, oldest first.

        Raises:
            UserError: If the group is no vector.
        """
        if len(group.shape) != 1:
            raise UserError(f"observation group '{name}' is no vector; FastTD3's replay buffer keeps vectors alone.")
        history, width = group.history, group.shape[0] // group.history
        newest, stacking, start = [], [], 0
        for (size,) in group.term_shapes.values():
            columns = torch.arange(start, start + size)
            newest.append(torch.arange(size) + history * start + (history - 1) * size)
            stacking.append((columns + width * torch.arange(history)[:, None]).flatten())
            start += size
        return cls(history, torch.cat(newest).to(device), torch.cat(stacking).to(device))


class Replay:
    """The last steps of every env, one frame of each observation group for each.

    An env's steps lie one after another in its ring. After the last step of an episode that was cut off stands one more
    frame, without an action: the state in which it ended, whose value follows. Likewise the newest frame is that of the
    state that no action has answered yet. Nothing here waits for the device.

    Args:
        layouts: The observation groups.
        num_envs: Number of envs N.
        num_actions: Size of an action J.
        steps: Number of frames T that the ring of an env holds.
        dtype: Type in which observations and actions are kept; numbers too large for it are kept as its largest.
        device: Device of all tensors.

    Attributes:
        collected: Control steps that were added.

    Raises:
        UserError: If it does not fit into the memory that is free.
    """

    def __init__(
        self,
        layouts: Mapping[str, FrameLayout],
        num_envs: int,
        num_actions: int,
        steps: int,
        dtype: torch.dtype,
        device: torch.device,
    ) -> None:
        self._layouts, self._num_envs, self._steps = layouts, num_envs, steps
        # A window that is drawn needs the history of its first step, and of the step before that one.
        self._lead = max(layout.history for layout in layouts.values())
        widths = {name: len(layout.newest) for name, layout in layouts.items()}
        _require_room(num_envs, steps, sum(widths.values()) + num_actions, dtype, device)
        rows = steps * num_envs
        self._most = torch.finfo(dtype).max
        self._frames = {name: torch.zeros(rows, width, dtype=dtype, device=device) for name, width in widths.items()}
        self._action = torch.zeros(rows, num_actions, dtype=dtype, device=device)
        self._reward = torch.zeros(rows, device=device)
        self._fell = torch.zeros(rows, dtype=torch.bool, device=device)
        self._cut_off = torch.zeros(rows, dtype=torch.bool, device=device)
        # Frames of the episode before this one, counted no further than a history reaches.
        self._age = torch.zeros(rows, dtype=torch.int16, device=device)
        self._env = torch.arange(num_envs, device=device)
        # Frames of each env so far, the newest one not among them. They are never counted from 0 again.
        self._head = torch.zeros(num_envs, dtype=torch.int64, device=device)
        self._age_now = torch.zeros(num_envs, dtype=torch.int16, device=device)
        self.collected = 0

    def add(
        self,
        obs: TensorDict,
        action: Tensor,
        reward: Tensor,
        terminated: Tensor,
        time_outs: Tensor,
        terminal_obs: TensorDict,
    ) -> None:
        """Adds a step of every env; `terminal_obs` are the observations after it, before resets."""
        row, after = self._rows(self._head, self._env), self._rows(self._head + 1, self._env)
        cut_off = time_outs & ~terminated
        for name, layout in self._layouts.items():
            self._frames[name][row] = self._kept(obs[name][:, layout.newest])
            self._frames[name][after] = self._kept(terminal_obs[name][:, layout.newest])
        self._action[row] = self._kept(action)
        self._reward[row] = reward
        self._fell[row], self._cut_off[row] = terminated, cut_off
        self._fell[after], self._cut_off[after] = False, False  # what the ring held before
        self._age[row], self._age[after] = self._age_now, self._age_now + 1
        self._head += 1 + cut_off.to(torch.int64)
        self._age_now += 1
        self._age_now.clamp_(max=self._lead).masked_fill_(terminated | cut_off, 0)
        self.collected += 1

    def cut(self) -> None:
        """Ends all episodes as if they were cut off here: the next steps do not follow those before."""
        going_on = self._age_now > 0
        last = self._rows(self._head - 1, self._env)
        self._cut_off[last] |= going_on
        self._head += going_on.to(torch.int64)
        self._age_now.zero_()

    def draw(self, size: int, n_step: int, gamma: float) -> Batch:
        """Windows of up to `n_step` steps that begin at any step with equal probability; at the last step of an episode
        that was cut off with twice that.

        A window ends with its episode, and with the newest step. What follows counts unless the robot fell.
        """
        env = torch.randint(self._num_envs, (size,), device=self._env.device)
        head = self._head[env]
        first = (head - self._steps + 1 + self._lead).clamp(min=0) * (head >= self._steps)
        start = first + (torch.rand(size, device=head.device) * (head - first)).to(torch.int64)
        start = torch.minimum(start, head - 1)  # the product above may be rounded up
        # No action answers the frame in which an episode was cut off; the step before it does for it.
        start = start - self._cut_off[self._rows(start - 1, env)].to(torch.int64)
        return self.windows(env, start, n_step, gamma)

    def windows(self, env: Tensor, start: Tensor, n_step: int, gamma: float) -> Batch:
        """The windows of up to `n_step` steps that begin at the frames `start` [B] of `env` [B]."""
        ahead = torch.arange(n_step, device=env.device)
        steps = start[:, None] + ahead  # [B, n]
        rows = self._rows(steps, env[:, None])
        fell = self._fell[rows]
        ended = (fell | self._cut_off[rows]).to(torch.int64)
        inside = (ended.cumsum(dim=1) == ended) & (steps < self._head[env][:, None])  # no end before this step
        length = inside.sum(dim=1)
        goes_on = ~(fell & inside).any(dim=1)
        first = rows[:, 0]
        return Batch(
            obs=self.observations(env, start),
            action=self._action[first].to(torch.float32),
            reward=(self._reward[rows] * inside) @ gamma ** ahead.to(torch.float32),
            discount=gamma ** length.to(torch.float32) * goes_on,
            next_obs=self.observations(env, start + length),
        )

    def observations(self, env: Tensor, frame: Tensor) -> dict[str, Tensor]:
        """What was observed at the frames `frame` [B] of `env` [B], histories included, by group."""
        age = self._age[self._rows(frame, env)][:, None].to(torch.int64)  # [B, 1]
        seen = {}
        for name, layout in self._layouts.items():
            back = torch.arange(layout.history - 1, -1, -1, device=env.device)  # [H] the oldest first
            # Before the first frame of an episode stands that frame itself.
            rows = self._rows(frame[:, None] - torch.minimum(back, age), env[:, None])  # [B, H]
            frames = self._frames[name][rows].flatten(1)  # [B, H * D]
            seen[name] = frames[:, layout.stacking].to(torch.float32)
        return seen

    def _rows(self, frame: Tensor, env: Tensor) -> Tensor:
        """Where the frames of envs lie in memory."""
        return frame % self._steps * self._num_envs + env

    def _kept(self, values: Tensor) -> Tensor:
        return values.clamp(-self._most, self._most).to(self._action.dtype)


def _require_room(num_envs: int, steps: int, numbers: int, dtype: torch.dtype, device: torch.device) -> None:
    """Raises UserError unless a buffer with so many numbers for each step fits into the free memory."""
    beside = 4 + 1 + 1 + 2  # reward, two flags, age
    per_step = num_envs * (numbers * dtype.itemsize + beside)
    free = free_memory(device)
    if steps * per_step > SHARE_OF_FREE * free:
        fit = int(SHARE_OF_FREE * free / per_step)
        raise UserError(
            f"agent.buffer_steps {steps} takes {steps * per_step / 1e9:.1f} GB for {num_envs} envs, but only "
            f"{free / 1e9:.1f} GB are free on {device}; at most {fit} steps fit."
        )
