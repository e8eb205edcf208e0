"""Exports in the training simulator: the environment that a contract describes, and its network as the policy."""

from __future__ import annotations

import dataclasses
import inspect
import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract, Term, Training
from humoslope.deploy.controller import OnnxPolicy
from humoslope.deploy.quantities import GAIT_PHASE
from humoslope.env import EnvCfg, ManagerBasedRlEnv, SceneCfg, SimCfg
from humoslope.errors import UserError
from humoslope.evaluation.subject import Subject
from humoslope.export.folder import joints_of
from humoslope.learning.checkpoint import digest
from humoslope.learning.policy import Provenance
from humoslope.managers import ObservationGroupCfg, ObservationTermCfg, Terms, VelocityCommandCfg
from humoslope.managers.terms import StatefulTerm
from humoslope.mdp import observations
from humoslope.ranges import Finite, Positive
from humoslope.registry import content_named
from humoslope.scene.redriven import redriven
from humoslope.scene.robot import Robot
from humoslope.terrain.grid import TileRowCfg


def linear_velocity_command(env: ManagerBasedRlEnv) -> Tensor:
    """Commanded speed forward and left, m/s, [N, 2]."""
    return env.commands.velocity[:, :2]


def yaw_rate_command(env: ManagerBasedRlEnv) -> Tensor:
    """Commanded yaw rate, rad/s, [N, 1]."""
    return env.commands.velocity[:, 2:]


class GaitPhase(StatefulTerm):
    """Sine or cosine of the phases of the left and the right foot by a contract's gait clock, [N, 2].

    Args:
        function: What is observed of the phases.
        period_s: As in `GaitClock`.
        offsets_rad: As in `GaitClock`.
        rest_below: As in `GaitClock`.
    """

    def __init__(
        self,
        env: ManagerBasedRlEnv,
        function: Literal["sine", "cosine"],
        period_s: Positive,
        offsets_rad: tuple[float, ...],
        rest_below: Finite,
    ) -> None:
        self._of = torch.sin if function == "sine" else torch.cos
        self._rest_below, self._step = rest_below, 2.0 * math.pi * env.step_dt / period_s
        self._offsets = torch.tensor(offsets_rad, device=env.device)
        self._moved = env.zeros()  # [N] control steps of the present motion

    def reset(self, mask: Tensor) -> None:
        """Lets the envs in `mask` [N] begin at rest."""
        self._moved = self._moved.masked_fill(mask, 0.0)

    def __call__(self, env: ManagerBasedRlEnv) -> Tensor:
        """The next control step."""
        command = env.commands.velocity
        rests = (command[:, :2].norm(dim=1) < self._rest_below) & (command[:, 2].abs() < self._rest_below)
        self._moved = (self._moved + 1.0).masked_fill(rests, 0.0)
        phase = self._offsets + self._step * (self._moved - 1.0)[:, None]
        return self._of(torch.where(rests[:, None], math.pi, phase))


FUNCTIONS: dict[str, Any] = {
    **{
        vars(func)["measured_quantity"]: func
        for func in vars(observations).values()
        if inspect.isfunction(func) and "measured_quantity" in vars(func)
    },
    "linear_velocity_command": linear_velocity_command,
    "yaw_rate_command": yaw_rate_command,
    "root_linear_velocity": observations.base_lin_vel,
}
"""Observations by their quantities; those of a gait clock are `GaitPhase`."""


class OnnxActor:
    """The network of an export as the policy of an environment. It takes one env after the other.

    Args:
        policy: The network.
        device: Device of the actions.
    """

    def __init__(self, policy: OnnxPolicy, device: torch.device) -> None:
        self._policy, self._device = policy, device

    def __call__(self, obs: TensorDict) -> Tensor:
        """Actions [N, J] for the observations of all envs."""
        groups: Any = obs.items()
        arrays = {str(group): value.cpu().numpy() for group, value in groups}
        rows = [{group: value[i] for group, value in arrays.items()} for i in range(obs.batch_size[0])]
        actions = np.stack([self._policy(row) for row in rows])
        return torch.from_numpy(actions).to(self._device, torch.float32)


def of_export(folder: Path) -> Subject:
    """Returns the policy of an export folder, for its robot as it is registered, with the gains of the contract.

    Raises:
        UserError: If the export is broken, its robot is not registered or has changed, or it sees what only the code
            that it was trained with can compute.
    """
    source = contracts.located(folder)
    contract = contracts.read(source)
    policy = OnnxPolicy(source, contract.network)
    provenance = dataclasses.replace(
        _provenance(contract.training, folder),
        sha256=digest(source / contracts.FILE),
        formerly=(contract.training.sha256,),
        variant=contract.training.origin,
    )
    groups = tuple(group.name for group in contract.observations)
    return Subject(provenance, env_of(contract), groups, lambda env: OnnxActor(policy, env.device))


def env_of(contract: Contract) -> EnvCfg:
    """Returns the environment that a contract describes: robot, actions, observations and commands, without ground.

    Raises:
        UserError: As `of_export`.
    """
    timing, law = contract.timing, contract.commands.steering
    # Without `measured` an observation is one physics step old, whatever that is in the evaluation.
    aged = timing.observation_age_s > timing.physics_step_s + 1e-9
    return EnvCfg(
        scene=SceneCfg(_robot(contract), TileRowCfg([])),
        sim=SimCfg(
            timestep=timing.physics_step_s,
            decimation=contract.decimation,
            observation_age_s=timing.observation_age_s if aged else None,
        ),
        command=VelocityCommandCfg(
            yaw_rate=contract.commands.yaw_rate_rad_s,
            heading_gain=law.heading_gain_per_s,
            lateral_gain=law.lateral_gain_rad_m,
            yaw_rate_limit=law.limit_rad_s,
        ),
        observations=Terms(
            **{
                group.name: ObservationGroupCfg(
                    Terms(**{term.name: _term(term, contract, aged) for term in group.terms}),
                    history=group.history,
                    enable_corruption=True,
                )
                for group in contract.observations
            }
        ),
    )


def _term(term: Term, contract: Contract, aged: bool) -> ObservationTermCfg:
    if term.quantity.startswith(GAIT_PHASE):
        assert contract.gait_clock is not None  # a contract without one has no such term
        params = {"function": term.quantity.removeprefix(GAIT_PHASE), **vars(contract.gait_clock)}
        return ObservationTermCfg(GaitPhase, params, term.training_noise, term.scale)
    if term.quantity not in FUNCTIONS:
        raise UserError(
            f"observation '{term.name}' is a custom quantity ({term.meaning or 'not described'}); only the checkpoint "
            "can be evaluated, with the code that it was trained with."
        )
    function = FUNCTIONS[term.quantity]
    takes_age = aged and "measured" in inspect.signature(function).parameters
    return ObservationTermCfg(function, {"measured": True} if takes_age else {}, term.training_noise, term.scale)


def _robot(contract: Contract) -> Robot:
    """The registered robot with the default pose, the gains and the action scales of the contract."""
    name, joints = contract.robot.name, contract.joints
    robot = content_named(Robot, name, "the export's robot")
    registered = joints_of(robot, robot.make_spec().compile())
    fixed = [(joint.name, joint.effort_limit_nm, joint.armature_kg_m2) for joint in joints]
    if fixed != [(joint.name, joint.effort_limit_nm, joint.armature_kg_m2) for joint in registered]:
        raise UserError(f"the export's robot {name} has other joints or motors than the one that is registered.")
    if joints != registered:
        robot = redriven(
            robot,
            tuple(joint.default_rad for joint in joints),
            tuple(joint.action_scale_rad for joint in joints),
            tuple(joint.stiffness_nm_rad for joint in joints),
            tuple(joint.damping_nms_rad for joint in joints),
        )
    return dataclasses.replace(robot, default_root_height=contract.robot.default_root_height_m)


def _provenance(training: Training, path: Path) -> Provenance:
    before = training.started_from
    return Provenance(
        path=path,
        sha256=training.sha256,
        task=training.task,
        iteration=training.iteration,
        total_steps=training.environment_steps,
        harness=training.harness,
        parent=None if before is None else _provenance(before, Path(before.checkpoint)),
    )
