"""The environment: many worlds of one robot on one terrain, driven by managers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import mujoco
import numpy as np
import torch
from rich.console import Console
from tensordict import TensorDict
from torch import Tensor

from humoslope.cpu import on_one_thread
from humoslope.errors import UserError
from humoslope.managers import (
    ActionManager,
    CommandManager,
    CurriculumManager,
    EventManager,
    EventTermCfg,
    JointPositionActionCfg,
    Log,
    ObservationGroupCfg,
    ObservationManager,
    RewardManager,
    RewardTermCfg,
    TermCfg,
    TerminationManager,
    TerminationTermCfg,
    Terms,
    VelocityCommandCfg,
)
from humoslope.scene.height_scan import HeightScan, HeightScanCfg
from humoslope.scene.robot import Robot
from humoslope.scene.scene import build_model
from humoslope.scene.signals import Signals
from humoslope.scene.tiles import Tiles
from humoslope.sim import make_simulation
from humoslope.sim.divergence import DivergenceRecorder
from humoslope.strict import StrictCfg
from humoslope.terrain.grid import TerrainGridCfg, TileRowCfg
from humoslope.terrain.queries import TerrainQueries


@dataclass
class SimCfg(StrictCfg):
    """Physics.

    Attributes:
        timestep: Physics step, s.
        decimation: Physics steps per control step.
        cone: Friction cone. The pyramidal one is faster, but its friction depends on direction.
        backend: "warp" for CUDA, "native" for the CPU; "auto" chooses.
        device: Where the tensors live: "auto", "cpu", "cuda" or "cuda:N".
        nconmax, njmax: Contacts and constraint rows per world; warp only.
    """

    timestep: float = 0.005
    decimation: int = 4
    cone: Literal["elliptic", "pyramidal"] = "elliptic"
    backend: Literal["auto", "native", "warp"] = "auto"
    device: str = "auto"
    nconmax: int = 48
    njmax: int = 192


@dataclass
class SceneCfg(StrictCfg):
    """The robot, the ground it walks on, and what is scanned of it."""

    robot: Robot
    terrain: TerrainGridCfg | TileRowCfg
    height_scan: HeightScanCfg = field(default_factory=HeightScanCfg)


@dataclass
class EnvCfg(StrictCfg):
    """Everything that defines an environment."""

    scene: SceneCfg
    sim: SimCfg = field(default_factory=SimCfg)
    num_envs: int = 512
    episode_length_s: float = 20.0
    seed: int = 1
    actions: JointPositionActionCfg = field(default_factory=JointPositionActionCfg)
    command: VelocityCommandCfg = field(default_factory=VelocityCommandCfg)
    observations: Terms[ObservationGroupCfg] = field(default_factory=Terms)
    rewards: Terms[RewardTermCfg] = field(default_factory=Terms)
    terminations: Terms[TerminationTermCfg] = field(default_factory=Terms)
    events: Terms[EventTermCfg] = field(default_factory=Terms)
    curriculum: Terms[TermCfg] = field(default_factory=Terms)


class ManagerBasedRlEnv:
    """Steps all worlds at once; a world whose episode ends is reset within the step.

    Nothing in `step` waits for the device: managers and terms work on all worlds, with masks.
    """

    def __init__(self, cfg: EnvCfg) -> None:
        if cfg.num_envs < 1:
            raise UserError(f"num_envs {cfg.num_envs} must be at least 1.")
        positive = 0.0 < cfg.episode_length_s < math.inf and 0.0 < cfg.sim.timestep < math.inf
        if not positive or cfg.sim.decimation < 1:
            raise UserError("episode_length_s and sim.timestep must be positive, sim.decimation at least 1.")
        self.cfg = cfg
        self.robot = cfg.scene.robot
        self.num_envs = cfg.num_envs
        terrain = cfg.scene.terrain.build()
        self.sim = make_simulation(
            build_model(self.robot, terrain, cfg.sim.timestep, cfg.sim.cone),
            cfg.num_envs,
            backend=cfg.sim.backend,
            device=cfg.sim.device,
            nconmax=cfg.sim.nconmax,
            njmax=cfg.sim.njmax,
        )
        self.device = self.sim.device
        torch.manual_seed(cfg.seed)
        self.step_dt = cfg.sim.timestep * cfg.sim.decimation
        self.max_episode_length = round(cfg.episode_length_s / self.step_dt)
        self.episode_length_buf = self.zeros(dtype=torch.int64)  # [N] control steps, name as rsl_rl wants it
        self.log = Log(self.device)
        self.terrain = TerrainQueries(terrain, self.device)
        self.tiles = Tiles(terrain, cfg.num_envs, self.device)
        self.signals = Signals(self.sim, self.robot, self.terrain)
        self.height_scan = HeightScan(cfg.scene.height_scan, self.signals, self.terrain, self.tiles)
        self.default_joint_pos = torch.tensor(self.robot.default_joint_pos, device=self.device)  # [J] rad
        root = (0.0, 0.0, self.robot.default_root_height, 1.0, 0.0, 0.0, 0.0)
        self._default_qpos = torch.tensor([*root, *self.robot.default_joint_pos], device=self.device)  # [nq]
        ranges = [self.sim.model.joint(name).range for name in self.robot.joint_names]
        self.joint_range = torch.tensor(np.array(ranges), dtype=torch.float32, device=self.device)  # [J, 2] rad
        self._qpos, self._qvel = self.sim.state("qpos"), self.sim.state("qvel")
        self._divergence = DivergenceRecorder(self._qpos, self._qvel)
        self.diverged = self.zeros(dtype=torch.bool)  # [N] in the last step

        self.commands = CommandManager(self, cfg.command)
        self.actions = ActionManager(self, cfg.actions)
        self.events = EventManager(self, cfg.events)
        self.curriculum = CurriculumManager(self, cfg.curriculum)
        self.events.startup()
        self.terminations = TerminationManager(self, cfg.terminations)
        everywhere = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        self._restart(everywhere)
        self.observers: list[Callable[[ManagerBasedRlEnv], None]] = []  # called after rewards, before resets
        self.observations = ObservationManager(self, cfg.observations)
        self.rewards = RewardManager(self, cfg.rewards)
        self._obs = self.observations.compute(everywhere)

    @on_one_thread
    def step(self, action: Tensor, active: Tensor | None = None) -> tuple[TensorDict, Tensor, Tensor, Tensor]:
        """Advances every world by one control step.

        Args:
            action: [N, J].
            active: [N] bool; worlds whose physics matters, all by default (see `Simulation.step`).

        Returns:
            Observations after resets (fresh tensors), reward [N], failures [N] (bool) and time-outs [N] (bool).
        """
        self.actions.process(action)
        self.sim.step(self.cfg.sim.decimation, active)
        self.diverged = broken = self.sim.diverged()
        self._divergence.add(self._qpos, self._qvel)
        whole = self.sim.known_empty(broken)
        if not whole:
            self._divergence.keep(broken)
        self.signals.refresh(None if whole else broken)
        self.episode_length_buf = self.episode_length_buf + 1  # the log keeps the old one

        done = self.terminations.compute() | broken
        terminated, time_outs = self.terminations.terminated | broken, self.terminations.time_outs & ~broken
        reward = torch.where(broken, 0.0, self.rewards.compute(self.step_dt))
        self.log.add("Train/episode_length", self.episode_length_buf, done)
        self.log.add("Train/diverged", broken)
        self.log.add("Train/falls_per_second", terminated / self.step_dt)
        self.log.add("Train/speed", self.signals.root_lin_vel_t[:, 0], self.commands.moving)
        for observe in self.observers:
            observe(self)
        self.events.step(self.step_dt)
        self._reset(done)
        self.commands.step(self.step_dt)
        self._obs = self.observations.compute(done)
        return self._obs, reward, terminated, time_outs

    def get_observations(self) -> TensorDict:
        """The observations of the last step or reset."""
        return self._obs

    def _reset(self, mask: Tensor) -> None:
        self.curriculum.reset(mask)
        if self.sim.known_empty(mask):
            return
        self.rewards.reset(mask)
        self.terminations.reset(mask)
        self.observations.reset(mask)
        self._restart(mask)

    def _restart(self, mask: Tensor) -> None:
        """Puts the worlds in `mask` at the start of an episode. Reset events write `start_qpos` and `start_qvel`."""
        self.start_qpos = self._default_qpos.repeat(self.num_envs, 1)
        self.start_qvel = torch.zeros_like(self._qvel, dtype=torch.float32)
        self.events.reset(mask)
        self.sim.reset(mask, self.start_qpos, self.start_qvel)
        self.actions.reset(mask)
        self.signals.refresh()
        self.commands.reset(mask)
        self.episode_length_buf = self.episode_length_buf.masked_fill(mask, 0)

    def take_divergence(self) -> tuple[Tensor, Tensor] | None:
        """qpos [K, nq] and qvel [K, nv] before the first divergence since the last call, or None.
        Waits for the device."""
        return self._divergence.take()

    def zeros(self, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        """A zero tensor [N, *shape] on the environment's device."""
        return torch.zeros(self.num_envs, *shape, dtype=dtype, device=self.device)

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        """Uniform random numbers [N, *shape]."""
        return torch.empty(self.num_envs, *shape, device=self.device).uniform_(low, high)

    def body_id(self, name: str) -> int:
        """The id of a body of the model."""
        return int(mujoco.mj_name2id(self.sim.model, mujoco.mjtObj.mjOBJ_BODY, name))

    def state_dict(self) -> dict[str, Any]:
        """What a resumed run needs of the environment: the curriculum's state."""
        return {"curriculum": self.curriculum.state_dict(), "level": self.tiles.level.cpu()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict`.
        Worlds are spread over the saved levels if their number differs; all episodes start anew."""
        level = state["level"].to(self.device)
        index = torch.arange(self.num_envs, device=self.device) * len(level) // self.num_envs
        self.tiles.set_level(level[index].clamp(max=self.tiles.num_levels - 1))
        self.curriculum.load_state_dict(state["curriculum"])
        everywhere = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        self._restart(everywhere)
        self._obs = self.observations.compute(everywhere)

    def describe(self, console: Console) -> None:
        """Prints a table of every manager."""
        for manager in (
            self.actions,
            self.commands,
            self.observations,
            self.rewards,
            self.terminations,
            self.events,
            self.curriculum,
        ):
            console.print(manager.table())
