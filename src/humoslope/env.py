"""The environment: many envs of one robot on one terrain, driven by managers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal

import mujoco
import numpy as np
import torch
from rich.console import Console
from torch import Tensor

from humoslope import snapshot
from humoslope.cpu import on_one_thread
from humoslope.managers import (
    ActionManager,
    CurriculumManager,
    EventManager,
    EventTermCfg,
    FiniteWatch,
    JointPositionActionCfg,
    Log,
    ObservationGroupCfg,
    ObservationManager,
    ObserverManager,
    RewardManager,
    RewardTermCfg,
    TermCfg,
    TerminationManager,
    TerminationTermCfg,
    Terms,
    VelocityCommandCfg,
    commanded_and_walked,
    control_steps,
)
from humoslope.memory import require_memory
from humoslope.ranges import Range, Seed, Timestep, check_config, check_params
from humoslope.scene.bodies import Bodies
from humoslope.scene.drives import Drives
from humoslope.scene.height_scan import HeightScan, HeightScanCfg
from humoslope.scene.masses import Masses
from humoslope.scene.measurements import Measurements
from humoslope.scene.robot import Robot
from humoslope.scene.scene import build_model
from humoslope.scene.signals import Signals
from humoslope.scene.tiles import Tiles
from humoslope.sim import make_simulation
from humoslope.sim.device import find_device
from humoslope.sim.divergence import DivergenceRecorder
from humoslope.strict import StrictCfg
from humoslope.terrain.grid import TerrainGridCfg, TileRowCfg
from humoslope.terrain.queries import TerrainQueries

if TYPE_CHECKING:
    from tensordict import TensorDict


@dataclass
class SimCfg(StrictCfg):
    """Physics.

    Attributes:
        timestep: Physics step, s.
        decimation: Physics steps per control step.
        cone: Friction cone. The pyramidal one is faster, but its friction depends on direction.
        backend: "warp" for CUDA, "native" for the CPU, "auto" for the one that fits the device.
        device: Device of all tensors: "auto", "cpu", "cuda" or "cuda:N".
        num_threads: Threads of the native backend; 0 for all CPUs that the process may use.
        nconmax: Room for contacts per env; warp only.
        njmax: Room for constraint rows per env; warp only.
        max_control_delay_s: Longest control delay that the model has room for, s; 0 for no delay at all.
        observation_age_s: Age of the measurements that the policy sees, s, whatever the physics step; one physics step
            by default. It concerns observations with `measured`.
    """

    timestep: Timestep = 0.005
    decimation: Annotated[int, Range(1, 1000)] = 4
    cone: Literal["elliptic", "pyramidal"] = "elliptic"
    backend: Literal["auto", "native", "warp"] = "auto"
    device: str = "auto"
    num_threads: Annotated[int, Range(0, 1024)] = 0
    nconmax: Annotated[int, Range(1, 10_000)] = 48
    njmax: Annotated[int, Range(1, 10_000)] = 192
    max_control_delay_s: Annotated[float, Range(0.0, 0.5)] = 0.0
    observation_age_s: Annotated[float, Range(0.0, 0.5, open_low=True)] | None = None


@dataclass
class SceneCfg(StrictCfg):
    """The robot and its surroundings.

    Attributes:
        robot: Robot of every env.
        terrain: Ground that all envs share.
        height_scan: Points of the ground that are scanned around each robot.
    """

    robot: Robot
    terrain: TerrainGridCfg | TileRowCfg
    height_scan: HeightScanCfg = field(default_factory=HeightScanCfg)


@dataclass
class EnvCfg(StrictCfg):
    """Everything that defines an environment.

    Attributes:
        scene: Robot and terrain.
        sim: Physics.
        num_envs: Number of envs (robots), stepped together.
        episode_length_s: Longest duration of an episode, s.
        seed: Seed of torch's generator, from which all random numbers of the environment come.
        actions: Action scale.
        command: Velocity command.
        observations: Observation groups.
        rewards: Reward terms.
        terminations: Reasons to end an episode.
        events: Randomisation, resets and disturbances.
        curriculum: Curricula.
        observers: What measures and records, and changes nothing.
    """

    scene: SceneCfg
    sim: SimCfg = field(default_factory=SimCfg)
    num_envs: Annotated[int, Range(1, 1_000_000)] = 512
    episode_length_s: Annotated[float, Range(0.0, 100_000.0, open_low=True)] = 20.0
    seed: Seed = 1
    actions: JointPositionActionCfg = field(default_factory=JointPositionActionCfg)
    command: VelocityCommandCfg = field(default_factory=VelocityCommandCfg)
    observations: Terms[ObservationGroupCfg] = field(default_factory=Terms)
    rewards: Terms[RewardTermCfg] = field(default_factory=Terms)
    terminations: Terms[TerminationTermCfg] = field(default_factory=Terms)
    events: Terms[EventTermCfg] = field(default_factory=Terms)
    curriculum: Terms[TermCfg] = field(default_factory=Terms)
    observers: Terms[TermCfg] = field(default_factory=Terms)


REMEMBERING = (
    *("commands", "actions", "events", "curriculum", "terminations", "observations", "observers", "rewards"),
    *("tiles", "drives", "masses", "measurements"),
)
"""Parts of an environment that remember something from step to step."""
EPISODES = ("episode_length_buf", "steps_since_reset", "start_root_pos_w", "diverged")
"""What an environment itself remembers."""
BYTES_PER_ENV = 150_000
"""Memory of an env on the CPU beyond histories and scans: 190 kB in all were measured with Stage I, from 512 to 4096
envs."""


def _bytes_per_env(cfg: EnvCfg) -> float:
    """A low estimate of the memory of an env, for a refusal before anything is built."""
    frames = sum(group.history for group in cfg.observations.values())
    history = 4 * 4 * 100 * frames  # four copies of some 100 numbers in single precision
    past = cfg.sim.max_control_delay_s + (cfg.sim.observation_age_s or 0.0)
    delayed = 8 * 100 * past / cfg.sim.timestep
    scanned = 4 * 20 * cfg.scene.height_scan.size**2
    return BYTES_PER_ENV + history + delayed + scanned


def _terms(cfg: EnvCfg) -> list[tuple[str, str, TermCfg]]:
    """Kind, name and configuration of every term."""
    kinds: dict[str, Mapping[str, TermCfg]] = {
        "reward": cfg.rewards,
        "termination": cfg.terminations,
        "event": cfg.events,
        "curriculum": cfg.curriculum,
        "observer": cfg.observers,
    }
    named = [(kind, name, term) for kind, terms in kinds.items() for name, term in terms.items()]
    named += [("observation", name, term) for group in cfg.observations.values() for name, term in group.terms.items()]
    return named


def _check_terms(cfg: EnvCfg) -> None:
    """Checks the parameters of every term against their ranges, as `bind` does again with the environment at hand: a
    wrong one is not worth the seconds in which a terrain is drawn."""
    for kind, name, term in _terms(cfg):
        check_params(f"{kind} '{name}'", term.func, term.params)


class ManagerBasedRlEnv:
    """Environment of N envs that are stepped together; an env whose episode ends is reset within the step.

    Nothing in `step` waits for the device: managers and terms work on all envs, with masks.

    A reset works on rows of three tensors that exist while reset events run: `start_qpos` [N, nq] and `start_qvel`
    [N, nv], which begin as the robot's default pose at rest in the world's origin, and `start_wrench` [N, bodies, 6],
    external force and torque on each body in the world frame, which begins as zero. Reset events write into them;
    then the envs in question start from them, with the default pose as joint targets.

    Attributes:
        episode_length_buf: [N] control steps of the episode, as counted for time-outs. A learner may write it to
            spread the time-outs of the first episodes.
        steps_since_reset: [N] control steps since the last reset.
        max_episode_length: Control steps of the longest episode.
        step_dt: Duration of a control step, s.
        start_root_pos_w: [N, 3] position of the root at the start of the episode, m.
        diverged: [N] bool; envs whose physics failed numerically in the last step.
        bodies: Poses of bodies by name, if a term reads them.
        observers: What measures and records, see `ObserverManager`.
        terminal_observations: See `enable_terminal_observations`.
    """

    terminal_observations: TensorDict

    def __init__(self, cfg: EnvCfg) -> None:
        check_config("env", cfg)
        _check_terms(cfg)
        if find_device(cfg.sim.backend, cfg.sim.device).type == "cpu":
            require_memory("env.num_envs", cfg.num_envs, _bytes_per_env(cfg))
        self.cfg = cfg
        self.robot = cfg.scene.robot
        self.num_envs = cfg.num_envs
        self.step_dt = cfg.sim.timestep * cfg.sim.decimation
        self.max_episode_length = control_steps("episode_length_s", cfg.episode_length_s, self.step_dt)
        terrain = cfg.scene.terrain.build()
        self.sim = make_simulation(
            build_model(self.robot, terrain, cfg.sim.timestep, cfg.sim.cone, cfg.sim.max_control_delay_s),
            cfg.num_envs,
            backend=cfg.sim.backend,
            device=cfg.sim.device,
            num_threads=cfg.sim.num_threads,
            nconmax=cfg.sim.nconmax,
            njmax=cfg.sim.njmax,
        )
        self.device = self.sim.device
        torch.manual_seed(cfg.seed)
        self.episode_length_buf = self.zeros(dtype=torch.int64)  # named as rsl_rl expects
        self.steps_since_reset = self.zeros(dtype=torch.int64)
        self.log = Log(self.device)
        self.finite = FiniteWatch(self.num_envs, self.device)
        self.terrain = TerrainQueries(terrain, self.device)
        self.tiles = Tiles(terrain, cfg.num_envs, self.device)
        self.signals = Signals(self.sim, self.robot, self.terrain)
        self.drives = Drives(self.sim, self.robot)
        self.masses = Masses(self.sim)
        self.measurements = Measurements(
            self.sim, self.signals, self.drives, cfg.sim.timestep, cfg.sim.observation_age_s
        )
        self.height_scan = HeightScan(cfg.scene.height_scan, self.signals, self.terrain, self.tiles)
        self.default_joint_pos = torch.tensor(self.robot.default_joint_pos, device=self.device)  # [J] rad
        root = (0.0, 0.0, self.robot.default_root_height, 1.0, 0.0, 0.0, 0.0)
        self._default_qpos = torch.tensor([*root, *self.robot.default_joint_pos], device=self.device)  # [nq]
        ranges = [self.sim.model.joint(name).range for name in self.robot.joint_names]
        self.joint_range = torch.tensor(np.array(ranges), dtype=torch.float32, device=self.device)  # [J, 2] rad
        self._qpos, self._qvel = self.sim.state("qpos"), self.sim.state("qvel")
        self._divergence = DivergenceRecorder(self._qpos, self._qvel)
        self.diverged = self.zeros(dtype=torch.bool)
        self.start_root_pos_w = self.zeros(3)
        self._keeps_terminal_observations = False

        self.bodies = Bodies(self.sim, [cfg.command, *(term.func for _, _, term in _terms(cfg))])
        self.commands = cfg.command.build(self)
        self.actions = ActionManager(self, cfg.actions)
        self.events = EventManager(self, cfg.events)
        self.curriculum = CurriculumManager(self, cfg.curriculum)
        self.events.startup()
        self.terminations = TerminationManager(self, cfg.terminations)
        everywhere = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        self.curriculum.begin()
        self._restart(everywhere)
        self.observations = ObservationManager(self, cfg.observations)
        self.observers = ObserverManager(self, cfg.observers)
        self.rewards = RewardManager(self, cfg.rewards)
        self.observers.reset(everywhere)  # rewards were called once, to find their shapes
        self._obs = self.observations.compute(everywhere)

    @on_one_thread
    def step(self, action: Tensor, active: Tensor | None = None) -> tuple[TensorDict, Tensor, Tensor, Tensor]:
        """Advances every env by one control step.

        In this order:
            1. action: joint targets for the whole step;
            2. physics: `sim.decimation` physics steps, with the readings of the robot's sensors on the way; envs that
               diverged are found;
            3. signals: everything terms read, all of one instant; envs that diverged read zero;
            4. terminations;
            5. rewards;
            6. observers: see the episode with its terminations and rewards, before anything changes it;
            7. events: step events, then interval events that are due;
            8. terminal observation, if enabled;
            9. curriculum: first its step, then the episodes that end;
            10. reset of the envs whose episode ended: reset events, state, signals, a new command;
            11. commands: drawn again where their time is over, steered elsewhere;
            12. observations, which the next action answers.

        Args:
            action: [N, J].
            active: [N] bool; envs whose physics matters, all by default (see `Simulation.step`).

        Returns:
            Observations after resets (fresh tensors), reward [N], failures [N] (bool) and time-outs [N] (bool).
        """
        self.finite.step += 1
        self.actions.process(action)

        self.measurements.advance(self.cfg.sim.decimation, active)
        self.diverged = self.sim.diverged()
        self._divergence.add(self._qpos, self._qvel)
        diverged = None if self.sim.known_empty(self.diverged) else self.diverged
        if diverged is not None:
            self._divergence.keep(diverged)

        self.signals.refresh(diverged)
        # Not in place: the log and the learner keep the old tensor.
        self.episode_length_buf = self.episode_length_buf + 1
        self.steps_since_reset = self.steps_since_reset + 1

        done = self.terminations.compute() | self.diverged
        terminated = self.terminations.terminated | self.diverged
        time_outs = self.terminations.time_outs & ~self.diverged

        reward = self.rewards.compute(self.step_dt, diverged)

        self.log.add("Train/episode_length", self.steps_since_reset, done)
        self.log.add("Train/diverged", self.diverged)
        self.log.add("Train/falls_per_second", terminated / self.step_dt)
        commanded, walked = commanded_and_walked(self)
        self.log.add("Train/speed", walked, commanded > 0.0)
        self.observers.step()

        self.events.step()

        terminal = self._terminal_observations(done)
        self.curriculum.step()
        if not self.sim.known_empty(done):
            self._reset(done)
        self.commands.step()
        self._obs = self.observations.compute(done)
        if self._keeps_terminal_observations:
            self.terminal_observations = self._obs if terminal is None else self._where_ended(terminal, done)
        return self._obs, reward, terminated, time_outs

    def reset(self, mask: Tensor | None = None) -> TensorDict:
        """Ends the episodes of the envs in `mask` [N], of all by default, as if their time had run out, and starts new
        ones; the other envs stay as they are. Returns the observations of all envs."""
        mask = torch.ones(self.num_envs, dtype=torch.bool, device=self.device) if mask is None else mask
        self._reset(mask)
        self._observe(mask)
        return self._obs

    def get_observations(self) -> TensorDict:
        """Returns the observations of the last step or reset."""
        return self._obs

    def enable_terminal_observations(self) -> None:
        """Makes every later `step` set `terminal_observations`, for learners that bootstrap from the last state.

        It then holds, for envs whose episode ended in the step, the observation at its end: of the state before the
        reset, under the command that held, history and noise included. For all other envs it holds the values that
        `step` returned. An env that diverged has no last state with a meaning; it counts among the others.
        """
        self._keeps_terminal_observations = True
        self.terminal_observations = self._obs

    def _terminal_observations(self, done: Tensor) -> TensorDict | None:
        """Observations before the reset, or None where they are not wanted or no episode is known to end."""
        if not self._keeps_terminal_observations or self.sim.known_empty(done):
            return None
        return self.observations.terminal()

    def _where_ended(self, terminal: TensorDict, done: Tensor) -> TensorDict:
        """`terminal` in the envs whose episode ended with a meaningful state, the present observations elsewhere."""
        ended = done & ~self.diverged
        groups = {
            name: torch.where(ended.view(-1, *[1] * len(group.shape)), terminal[name], self._obs[name])
            for name, group in self.observations.groups.items()
        }
        from tensordict import TensorDict

        return TensorDict(groups, batch_size=[self.num_envs], device=self.device)

    def non_finite(self) -> list[str]:
        """Returns a sentence per reward, observation term or action that was NaN or infinite since the last call.

        Envs whose physics diverged do not count: they are reset, and their signals read zero. Waits for the device.
        """
        return self.finite.report()

    def _reset(self, mask: Tensor) -> None:
        """Ends the episodes of the envs in `mask` [N] and starts new ones."""
        self.curriculum.reset(mask)
        self.rewards.reset(mask)
        # The reason for which an episode ended says little if the learner let it begin late: at first all would time
        # out early, however well they walked.
        self.terminations.reset(mask, self.steps_since_reset == self.episode_length_buf)
        self.observations.reset(mask)
        self.observers.reset(mask)
        self._restart(mask)

    def _restart(self, mask: Tensor) -> None:
        """Puts the envs in `mask` [N] at the start of an episode."""
        self.start_qpos = self._default_qpos.repeat(self.num_envs, 1)
        self.start_qvel = torch.zeros_like(self._qvel, dtype=torch.float32)
        self.start_wrench = self.zeros(self.sim.model.nbody, 6)
        self.events.reset(mask)
        self.sim.reset(mask, self.start_qpos, self.start_qvel, self.actions.default_ctrl, self.start_wrench)
        self.start_root_pos_w = torch.where(mask[:, None], self.start_qpos[:, :3], self.start_root_pos_w)
        self.actions.reset(mask)
        self.signals.refresh()
        self.measurements.reset(mask)
        self.commands.reset(mask)
        self.episode_length_buf = self.episode_length_buf.masked_fill(mask, 0)
        self.steps_since_reset = self.steps_since_reset.masked_fill(mask, 0)

    def _observe(self, restarted: Tensor) -> None:
        """Observes outside of a step, after episodes began in the envs `restarted` [N]."""
        self._obs = self.observations.compute(restarted)
        if self._keeps_terminal_observations:
            self.terminal_observations = self._obs

    def take_divergence(self) -> tuple[Tensor, Tensor] | None:
        """Returns qpos [K, nq] and qvel [K, nv] before the first divergence since the last call, or None.
        Waits for the device."""
        return self._divergence.take()

    def zeros(self, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        """Returns a zero tensor [N, *shape] on the environment's device."""
        return torch.zeros(self.num_envs, *shape, dtype=dtype, device=self.device)

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        """Returns uniform random numbers [N, *shape]."""
        return torch.empty(self.num_envs, *shape, device=self.device).uniform_(low, high)

    def body_id(self, name: str) -> int:
        """Returns the id of a body of the model, -1 if there is none."""
        return int(mujoco.mj_name2id(self.sim.model, mujoco.mjtObj.mjOBJ_BODY, name))

    def state_dict(self) -> dict[str, Any]:
        """Returns the state that a resumed run needs: the curriculum's."""
        return {"curriculum": self.curriculum.state_dict(), "level": self.tiles.level.cpu()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict`, with new episodes in all envs.
        If the number of envs differs, they are spread over the saved levels."""
        level = state["level"].to(self.device)
        index = torch.arange(self.num_envs, device=self.device) * len(level) // self.num_envs
        self.tiles.set_level(level[index].clamp(max=self.tiles.num_levels - 1))
        self.curriculum.load_state_dict(state["curriculum"])
        self.curriculum.begin()
        everywhere = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        self._restart(everywhere)
        self._observe(everywhere)

    def snapshot(self) -> dict[str, Any] | None:
        """Returns a copy of all that `state_dict` leaves out: physics, episodes and the memory of every manager and
        term. With the states of the random generators the steps to come follow from it, bit for bit.

        None if the physics cannot go on exactly (see `Simulation.snapshot`).
        """
        physics = self.sim.snapshot()
        if physics is None:
            return None
        return {
            "physics": physics,
            "memory": snapshot.take(*self._remembering(), self.sim.owns),
            "episodes": {name: getattr(self, name).clone() for name in EPISODES},
            "obs": {name: self._obs[name].clone() for name in self.observations.groups},
        }

    def snapshot_bytes(self) -> int:
        """Returns about how much memory a snapshot takes, bytes; 0 if there is none."""
        physics = self.sim.snapshot_bytes()
        return physics + snapshot.size(*self._remembering(), self.sim.owns) if physics else 0

    def restore(self, state: dict[str, Any]) -> None:
        """Goes on from the snapshot of an environment of the same configuration.

        Raises:
            KeyError, ValueError, RuntimeError: If it is one of another configuration.
        """
        from tensordict import TensorDict

        snapshot.check(state["memory"], *self._remembering(), self.sim.owns)
        self.sim.restore(state["physics"])
        snapshot.put(state["memory"], *self._remembering())
        for name in EPISODES:
            setattr(self, name, state["episodes"][name])
        self.signals.refresh()
        self._obs = TensorDict(state["obs"], batch_size=[self.num_envs], device=self.device)
        if self._keeps_terminal_observations:
            self.terminal_observations = self._obs

    def _remembering(self) -> tuple[dict[str, object], list[object]]:
        """The parts with a memory by name, and the parts without one that they refer to."""
        roots = {name: value for name, value in vars(self).items() if name in REMEMBERING}
        others = [value for name, value in vars(self).items() if name not in REMEMBERING]
        return roots, [self, *others, *self.finite.sources]

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
