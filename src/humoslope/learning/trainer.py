"""The training loop: collects, updates, logs, saves, stops and resumes, alike for every learner."""

from __future__ import annotations

import hashlib
import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from rich.console import Console

from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.files import write_atomically, write_bytes
from humoslope.interrupts import deferred_interrupts
from humoslope.learning import checkpoint
from humoslope.learning.distributed import Processes, any_process, mean_over_processes
from humoslope.learning.learner import Learner, Transition
from humoslope.learning.logger import CurveWriter, ProgressLine
from humoslope.learning.policy import load_weights, parent_record, spec_of, spec_state
from humoslope.learning.rng import restore_rng, rng_state, seed_everything
from humoslope.memory import free_memory
from humoslope.packing import pack
from humoslope.provenance import commit
from humoslope.registry import TaskCfg

EPISODES = "episodes"
"""Name of the file beside the newest checkpoint with the state of its episodes; 24 kB for an env of Stage I."""
RANK_SEED_STRIDE = 1_000_003
"""Distance in seed between the iterations at which the processes beyond the first one resume; a prime number."""


class Onlooker(Protocol):
    """Somebody who looks at a training and changes nothing in it: draws no random number, writes to no tensor."""

    def after_step(self) -> None:
        """Called after every control step."""

    def after_iteration(self, iteration: int, values: dict[str, float]) -> None:
        """Called after every iteration with its number and a point of every curve."""

    def close(self, finished: bool) -> None:
        """Called at the end of training, `finished` or stopped before."""


class Trainer:
    """Trains a task; one iteration is a rollout of `num_steps_per_env` steps and an update of the learner.

    Args:
        task: Name of the task, written into checkpoints.
        cfg: The configuration that `env` was built with; written into checkpoints.
        run_dir: Folder for curves and checkpoints; None writes nothing.
        processes: The processes that train together.

    Attributes:
        iteration: Number of iterations that are done.
        onlookers: Who looks on. One that fails is dismissed, and training goes on.
        stopped_by: The signal that ended the last `train` early, 0 if none did.
        on_lost_folder: Called when the run folder was removed and made anew.

    Raises:
        UserError: If the configuration of the agent is impossible or does not fit the environment.
    """

    def __init__(
        self,
        task: str,
        cfg: TaskCfg,
        env: ManagerBasedRlEnv,
        run_dir: Path | None,
        console: Console,
        processes: Processes | None = None,
    ) -> None:
        self.task, self.cfg, self.env, self.run_dir = task, cfg, env, run_dir
        self._console, self._processes = console, processes or Processes()
        cfg.agent.check()
        self.learner: Learner = cfg.agent.build(env)
        if self.learner.wants_terminal_obs:
            env.enable_terminal_observations()
        self.iteration, self.total_steps, self.total_time = 0, 0, 0.0
        self.onlookers: list[Onlooker] = []
        self._parent: dict[str, Any] | None = None
        self._config = pack(cfg)
        self._last_saved: Path | None = None
        self._half_learnt = False  # an update has begun that has not ended well
        self.stopped_by = 0
        self._goes_on = False  # the episodes are those of a run that was stopped
        self.on_lost_folder: Callable[[], object] = lambda: None

    def train(self) -> bool:
        """Trains up to the configured number of iterations.

        SIGINT, SIGTERM and SIGHUP save and end it early. So does any exception, unless it comes in the middle of an
        update: then the last checkpoint is named.

        Returns:
            Whether training is complete.

        Raises:
            UserError: If a reward, an observation or a weight is not finite, or a checkpoint cannot be written. The
                last good checkpoint is kept.
        """
        last, first = self.cfg.agent.max_iterations, self.iteration
        if first >= last:
            self._console.print(f"Nothing left to do: {first} iterations are done.")
            return True
        if not self._goes_on:
            self.start_episodes()
        self._report_learner()
        curves = CurveWriter(self.run_dir, self.cfg)
        line = ProgressLine(self._console, first, last)
        try:
            with deferred_interrupts(self._say_stop, second_raises=True) as interrupt:
                stopping = False
                while self.iteration < last and not stopping:
                    values = self.iterate()
                    self._keep_folder(curves)
                    curves.write(self.iteration - 1, values)
                    line.show(self.iteration - 1, values)
                    self._report_physics(values)
                    self._report_learner()
                    self._show(lambda onlooker: onlooker.after_iteration(self.iteration - 1, values))  # noqa: B023
                    (stopping,) = any_process((interrupt.requested,), self.env.device)
                    if stopping or self._is_saved_now(last):
                        self._save(curves)
        except Exception as error:
            self._rescue(error)
            raise
        finally:
            curves.close()
            self._show(lambda onlooker: onlooker.close(self.iteration == last))
        if self.iteration < last:
            self.stopped_by = interrupt.number or signal.SIGTERM  # or another process got the signal
            self._console.print(f"Stopped after iteration {self.iteration}; saved {self._last_saved}.")
        return self.iteration == last

    def start_episodes(self) -> None:
        """Spreads the episodes over their length and gives every process the same weights.

        Envs that all start at once would also end at once, and the learner would see one phase of the episode at a
        time.
        """
        buf = self.env.episode_length_buf
        self.env.episode_length_buf = torch.randint_like(buf, high=self.env.max_episode_length)
        if self._processes.size > 1:
            self.learner.synchronise()

    def iterate(self) -> dict[str, float]:
        """One iteration; returns a point of every curve.

        Raises:
            UserError: If a reward, an observation or a loss is not finite.
        """
        self.learner.begin(self.iteration)
        start = time.perf_counter()
        obs = self._collect()
        collected = self._now()
        self._require_finite_values()
        self._half_learnt = True
        with tf32_products(self.env.device):
            losses = self.learner.update(obs)
        if self._processes.size > 1:
            self.env.curriculum.average(mean_over_processes)
        learned = self._now()

        self.iteration += 1
        steps = self.cfg.agent.num_steps_per_env * self.env.num_envs * self._processes.size
        self.total_steps += steps
        self.total_time += learned - start
        self._require_finite_losses(losses)
        self._half_learnt = False
        return {
            **self.env.log.flush(),
            **losses,
            "Perf/steps_per_second": steps / (learned - start),
            "Perf/collection_time": collected - start,
            "Perf/learning_time": learned - collected,
            "Perf/total_steps": float(self.total_steps),
            "Perf/total_time": self.total_time,
        }

    def save(self, path: Path) -> None:
        """Writes a complete checkpoint in one step.

        Raises:
            UserError: If a weight is not finite; nothing is written then.
        """
        checkpoint.save(path, self.state())

    def state(self) -> dict[str, Any]:
        """Everything that a checkpoint holds; see `checkpoint`."""
        return {
            "task": self.task,
            "code": commit(),
            "iteration": self.iteration - 1,
            "total_steps": self.total_steps,
            "total_time": self.total_time,
            "config": self._config,
            "policy": {"spec": spec_state(self.learner.spec), "weights": self.learner.policy.state_dict()},
            "learner": self.learner.state_dict(),
            "env": self.env.state_dict(),
            "rng": rng_state(self.env.device),
            "parent": self._parent,
            "formerly": (),
        }

    def resume(self, path: Path) -> str:
        """Continues from a checkpoint of the same task: networks, optimisers, curricula, counters and random numbers.

        The newest checkpoint of a run of one process on the native backend has its episodes beside it, as
        episodes_N.pt: physics, commands, histories, and all else that terms remember. From there the run goes on as if
        it had never been stopped, bit for bit with a learner whose `state_dict` is complete, as PPO's is. Otherwise
        every episode starts anew. Every process beyond the first draws new random numbers, since a checkpoint holds
        only those of the first.

        Returns:
            A sentence that says which of the two it is, and why.

        Raises:
            UserError: If it cannot be used here.
        """
        state = checkpoint.load(path, self.task, self.env.device)
        if not state["learner"]:
            raise UserError(
                f"checkpoint '{path}' holds the actor alone: a run can start from it with --init, not resume."
            )
        self._load_policy(path, state)
        try:
            self.learner.load_state_dict(state["learner"])
            self.env.load_state_dict(state["env"])
        except (RuntimeError, ValueError) as error:
            raise _misfit(path, error) from None
        except KeyError as missing:
            raise UserError(f"checkpoint '{path}' lacks {missing}; another version of the code wrote it.") from None
        self.iteration = state["iteration"] + 1
        self.total_steps, self.total_time = state["total_steps"], state["total_time"]
        self._parent, self._last_saved = state["parent"], path
        if self._processes.is_first:
            restore_rng(state["rng"], self.env.device)
        else:
            seed_everything((self.env.cfg.seed + RANK_SEED_STRIDE * self.iteration) % 2**32)
        why_not = self._resume_episodes(path, state)
        self._goes_on = not why_not
        if self._goes_on:
            return "Its episodes go on where they were."
        return f"Its episodes start anew ({why_not}), so that it departs from a run that was never stopped."

    def warm_start(self, path: Path) -> None:
        """Takes the policy, with its normaliser, from a checkpoint of any task; everything else starts anew.
        Checkpoints of this run record it as their parent.

        Raises:
            UserError: If it cannot be used here.
        """
        state = checkpoint.load(path, device=self.env.device)
        self._load_policy(path, state)
        self._parent = parent_record(path, state)

    def _collect(self) -> Any:
        """A rollout; returns the observations after it."""
        env, learner = self.env, self.learner
        obs = env.get_observations()
        with torch.inference_mode():
            for _ in range(self.cfg.agent.num_steps_per_env):
                action = learner.act(obs)
                next_obs, reward, terminated, time_outs = env.step(action)
                env.log.add("Train/reward", reward / env.step_dt)
                terminal = env.terminal_observations if learner.wants_terminal_obs else None
                learner.take(Transition(obs, action, reward, terminated, time_outs, next_obs, terminal))
                obs = next_obs
                if self.onlookers:
                    self._show(lambda onlooker: onlooker.after_step())
        return obs

    def _show(self, look: Callable[[Onlooker], None]) -> None:
        """Lets every onlooker look; what goes wrong there must not end a training."""
        for onlooker in list(self.onlookers):
            try:
                look(onlooker)
            except Exception as error:  # whatever a viewer, a file or a child process can do
                self.onlookers.remove(onlooker)
                what = f"{type(error).__name__}: {error}".splitlines()[0]
                self._console.print(f"[yellow]{type(onlooker).__name__} is given up ({what}).[/yellow]", soft_wrap=True)

    def _resume_episodes(self, path: Path, state: dict[str, Any]) -> str:
        """Goes on with the episodes beside a checkpoint that was loaded; returns why that is impossible, or ""."""
        beside = _episodes_of(path)
        if self._processes.size > 1 or self.env.sim.backend != "native":
            return "only one process on the native backend keeps them"
        if not beside.is_file():
            return f"there is no {beside.name} beside it"
        if state["config"] is None or state["config"]["env"] != self._config["env"]:
            return "the environment is configured differently now"
        try:
            kept = checkpoint.load_sealed(beside)
            if kept["checkpoint"] != checkpoint.digest(path):
                return f"{beside.name} belongs to another checkpoint"
            self.env.restore(kept["state"])
        except (UserError, KeyError, TypeError, ValueError, RuntimeError):
            return f"{beside.name} is damaged or of another version"
        return ""

    def _save_with_episodes(self, path: Path) -> None:
        """Writes a checkpoint, and beside it the state of all episodes, if it can be continued.

        Whenever this is cut off, the newest checkpoint has its episodes: they are written before it, and those of the
        one before it are removed after it.
        """
        content = checkpoint.encoded(path, self.state())
        state = self._snapshot()
        if state is not None:
            kept = {"checkpoint": hashlib.sha256(content).hexdigest(), "state": state}
            write_bytes(_episodes_of(path), checkpoint.encoded_sealed(kept))
        try:
            write_bytes(path, content)
        except BaseException:
            _episodes_of(path).unlink(missing_ok=True)
            raise
        for old in path.parent.glob(f"{EPISODES}_*.pt"):
            if old != _episodes_of(path):
                old.unlink(missing_ok=True)

    def _snapshot(self) -> dict[str, Any] | None:
        """The state of all episodes; None if it cannot be continued, or there is no memory for it."""
        if self._processes.size > 1:
            return None
        # As a copy, as a file, and once more while that grows.
        need, free = 3 * self.env.snapshot_bytes(), free_memory(torch.device("cpu"))
        if need <= free:
            return self.env.snapshot()
        self._console.print(
            f"[yellow]The episodes are not kept: that needs {need / 2**30:.1f} GiB of memory, and only "
            f"{free / 2**30:.1f} GiB are free. A run that resumes from here begins them anew.[/yellow]",
            soft_wrap=True,
        )
        return None

    def _now(self) -> float:
        """The time, s, once the device has done what it was asked for."""
        if self.env.device.type == "cuda":
            torch.cuda.synchronize(self.env.device)
        return time.perf_counter()

    def _require_finite_values(self) -> None:
        """Ends all processes if one of them met a reward, an observation or an action that is not finite.

        The weights are those of the iteration before, which were good, so that they are saved first.
        """
        found = self.env.non_finite()
        (failed,) = any_process((bool(found),), self.env.device)
        if not failed:
            return
        with suppress(UserError):  # what could not be saved must not hide what happened
            self._keep_last_good()
        raise self._diverged("; ".join(found) or "another process met a value that is not finite", self.iteration + 1)

    def _require_finite_losses(self, losses: dict[str, float]) -> None:
        broken = [name for name, value in losses.items() if not math.isfinite(value)]
        (failed,) = any_process((bool(broken),), self.env.device)
        if failed:
            raise self._diverged(f"{', '.join(broken) or 'a loss of another process'} is not finite", self.iteration)

    def _diverged(self, said: str, iteration: int) -> UserError:
        return UserError(f"{said} (iteration {iteration}); {self._kept()}.")

    def _kept(self) -> str:
        return f"the last good checkpoint is {self._last_saved}" if self._last_saved else "there is no checkpoint yet"

    def _keep_last_good(self) -> None:
        """Saves the weights of the last complete iteration, unless they are saved already or half changed."""
        if self.run_dir is None or self.iteration == 0 or self._half_learnt:
            return
        path = self._model_path()
        if path != self._last_saved:
            self.save(path)
            self._last_saved = path

    def _rescue(self, error: Exception) -> None:
        """Keeps what can be kept when an error ends the run, and says what that is."""
        if isinstance(error, UserError):
            return
        with suppress(UserError):
            self._keep_last_good()
        what = type(error).__name__
        self._console.print(f"{what} after {self.iteration} iterations; {self._kept()}.", soft_wrap=True)

    def _is_saved_now(self, last: int) -> bool:
        return self.iteration == last or (self.iteration - 1) % self.cfg.agent.save_interval == 0

    def _save(self, curves: CurveWriter) -> None:
        if self.run_dir is None:
            return
        path = self._model_path()
        try:
            self._save_with_episodes(path)
        except UserError as error:
            raise UserError(f"{str(error).rstrip('.')}; {self._kept()}.") from error
        self._last_saved = path
        curves.flush()
        curves.upload(path, self.iteration - 1)

    def _keep_folder(self, curves: CurveWriter) -> None:
        """Makes the run folder anew if it was removed: that is no reason to end a training."""
        if self.run_dir is None or self.run_dir.is_dir():
            return
        self._console.print(
            f"[yellow]The run folder {self.run_dir} was removed; it is made anew, without what was in it.[/yellow]",
            soft_wrap=True,
        )
        self._last_saved = None
        self.run_dir.mkdir(parents=True, exist_ok=True)
        self.on_lost_folder()
        curves.renew()

    def _model_path(self) -> Path:
        assert self.run_dir is not None
        return self.run_dir / f"model_{self.iteration - 1}.pt"

    def _load_policy(self, path: Path, state: dict[str, Any]) -> None:
        trained, ours = spec_of(state), self.learner.spec
        if trained.network != ours.network:
            raise UserError(
                f"checkpoint '{path}' holds a network of kind '{trained.network}', this run has '{ours.network}'."
            )
        trained.check_fits(self.env, path)
        widths, own = (tuple(spec.settings.get("hidden_dims", ())) for spec in (trained, ours))
        if widths != own:
            raise UserError(
                f"the policy of checkpoint '{path}' has hidden layers of {widths}, this run's of {own}; "
                f"add --agent.hidden-dims {' '.join(map(str, widths))}."
            )
        activation, ours_has = (spec.settings.get("activation") for spec in (trained, ours))
        if activation != ours_has:
            raise UserError(
                f"the policy of checkpoint '{path}' has the activation {activation}, this run's {ours_has}; add "
                f"--agent.activation {activation}."
            )
        bound, own_bound = (spec.settings.get("bound") for spec in (trained, ours))
        if bound != own_bound:
            raise UserError(
                f"the policy of checkpoint '{path}' has actions of at most {bound:g}, this run's of {own_bound:g}; "
                f"add --agent.action-bound {bound:g}."
            )
        load_weights(self.learner.policy, state, path)

    def _report_learner(self) -> None:
        for remark in self.learner.remarks():
            self._console.print(f"[yellow]{remark}[/yellow]", soft_wrap=True, highlight=False)

    def _report_physics(self, values: dict[str, float]) -> None:
        # The consoles of all processes but the first are quiet, but a warning of any of them matters.
        console = self._console if self._processes.is_first else Console(stderr=True)
        who = "" if self._processes.is_first else f"process {self._processes.rank}, "
        for warning in self.env.sim.warnings():
            console.print(f"[yellow]{who}physics: {warning}[/yellow]", soft_wrap=True)
        if values.get("Train/diverged", 0.0) > 0.0:
            self._report_divergence()

    def _report_divergence(self) -> None:
        states = self.env.take_divergence()
        if states is None or self.run_dir is None:
            return
        qpos, qvel = states
        path = self.run_dir / "diverged" / f"iteration_{self.iteration - 1}.npz"
        write_atomically(path, lambda out: np.savez(out, qpos=qpos.numpy(), qvel=qvel.numpy()))
        self._console.print(f"[yellow]An env diverged and was reset; its last states are in {path}.[/yellow]")

    def _say_stop(self) -> None:
        self._console.print("Stopping after this iteration; Ctrl-C once more stops at once, without saving.")


@contextmanager
def tf32_products(device: torch.device) -> Iterator[None]:
    """Lets a GPU multiply matrices in TF32 while inside.

    For learning alone: rotations, scans and the terrain descriptor of the environment are matrix products as well, and
    ten bits of mantissa are too few for places in metres.
    """
    if device.type != "cuda":
        yield
        return
    before = torch.backends.cuda.matmul.fp32_precision
    torch.backends.cuda.matmul.fp32_precision = "tf32"
    try:
        yield
    finally:
        torch.backends.cuda.matmul.fp32_precision = before


def _episodes_of(path: Path) -> Path:
    return path.with_name(f"{EPISODES}_{path.stem.rpartition('_')[2]}.pt")


def _misfit(path: Path, error: Exception) -> UserError:
    detail = str(error).strip().splitlines()[-1].strip()
    return UserError(f"checkpoint '{path}' does not fit the configured networks: {detail}")
