"""Export of a trained policy: network, contract, robot model, and deploy.yaml for Unitree's deployment."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tensordict import TensorDict

from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.deploy.quantities import CUSTOM, QUANTITIES
from humoslope.env import EnvCfg, ManagerBasedRlEnv, SimCfg
from humoslope.errors import UserError, unknown
from humoslope.evaluation.common import rollout
from humoslope.export.folder import (
    ACTION,
    CONVENTIONS,
    described,
    exporter,
    joints_of,
    metadata,
    model_xml,
    network_of,
    robot_model,
    steering,
    write_export,
)
from humoslope.export.onnx import largest_difference, network_inputs, translate, with_metadata
from humoslope.learning.policy import Actor, Provenance
from humoslope.managers import ObservationGroupCfg, ObservationTermCfg, Terms, VelocityCommandCfg
from humoslope.managers.terms import bind, first_value
from humoslope.mdp import terminations

TOLERANCE = 1e-5
"""Largest difference between an action of the ONNX file and torch's."""


@dataclass(frozen=True)
class Exported:
    """Result of an export.

    Attributes:
        contract: The contract as written.
        difference: Largest difference between an action of the ONNX file and torch's.
        compared: Number of observations on which the two were compared.
        without_deploy_yaml: Reason why no deploy.yaml was written for Unitree's deployment; None if it was.
    """

    contract: Contract
    difference: float
    compared: int
    without_deploy_yaml: str | None


def record_observations(env: ManagerBasedRlEnv, actor: Actor, seconds: float) -> TensorDict:
    """Returns what the actor reads while it drives all envs for `seconds`: its groups, batch [K]."""
    seen: list[TensorDict] = []

    def act(obs: TensorDict) -> Any:
        seen.append(obs.select(*actor.spec.groups))
        return actor(obs)

    rollout(env, act, seconds, lambda failed, ended: None)
    recorded: TensorDict = TensorDict.cat(seen)
    return recorded


def export(actor: Actor, env: ManagerBasedRlEnv, trained: EnvCfg, observations: TensorDict, folder: Path) -> Exported:
    """Writes the policy into `folder`; the list of checksums last, so that a folder with one is complete.

    Args:
        actor: The policy.
        env: Environment of the task with the physics of the evaluation.
        trained: Configuration of the environment in training, for commands, noise and terminations.
        observations: Observations of a real rollout, batch [K], on which the ONNX file must agree with torch.
        folder: Folder to write into.

    Raises:
        UserError: If the contract cannot describe what the policy needs, or the ONNX file acts differently from torch.
    """
    groups = tuple(_group(name, getattr(trained.observations, name), env) for name in actor.spec.groups)
    joints = joints_of(env.robot, env.sim.model, trained.actions.scale_factor)
    told = metadata(joints, groups, actor.provenance.path.name)
    content = with_metadata(translate(actor, observations), told)
    difference = largest_difference(content, actor, observations)
    if not difference <= TOLERANCE:
        raise UserError(
            f"the ONNX file differs from torch by {difference:.2g} on {len(observations)} observations, more than "
            f"{TOLERANCE:g}; nothing was written."
        )
    model = model_xml(env.robot, env.sim.model.opt.timestep, env.sim.model.opt.cone)
    contract = make_contract(actor, env, trained, observations, content, model)
    without = write_export(folder, contract, content, model)
    return Exported(contract, difference, len(observations), without)


def make_contract(
    actor: Actor, env: ManagerBasedRlEnv, trained: EnvCfg, observations: TensorDict, onnx: bytes, model: str
) -> Contract:
    """Returns the contract of a policy.

    Args:
        actor: As in `export`.
        env: As in `export`.
        trained: As in `export`.
        observations: As in `export`; only the shapes are used.
        onnx: The ONNX file.
        model: The robot model.

    Raises:
        UserError: If an observation has no description, or the robot does not meet the assumptions of the descriptions.
    """
    robot, sim = env.robot, env.cfg.sim
    return Contract(
        format="humoslope-policy",
        version=2,
        exported_by=exporter(),
        conventions=CONVENTIONS,
        training=_training(actor.provenance),
        network=network_of(onnx, network_inputs(actor, observations), robot.num_joints),
        robot=robot_model(robot, model),
        timing=contracts.Timing(
            control_step_s=env.step_dt,
            physics_step_s=sim.timestep,
            observation_age_s=_observation_age(actor, trained, sim),
        ),
        action=ACTION,
        joints=joints_of(env.robot, env.sim.model, trained.actions.scale_factor),
        observations=tuple(_group(name, getattr(trained.observations, name), env) for name in actor.spec.groups),
        commands=_commands(trained.command),
        fall=_fall(trained.terminations),
    )


def _training(provenance: Provenance) -> contracts.Training:
    return contracts.Training(
        task=provenance.task,
        checkpoint=provenance.path.name,
        sha256=provenance.sha256,
        iteration=provenance.iteration,
        environment_steps=provenance.total_steps,
        harness=provenance.harness,
        started_from=None if provenance.parent is None else _training(provenance.parent),
    )


def _observation_age(actor: Actor, trained: EnvCfg, sim: SimCfg) -> float:
    """Age of all that the policy sees of the robot, s.

    Raises:
        UserError: If some of it has another age, because a contract has one for all.
    """
    ages: dict[str, float] = {}
    for group in actor.spec.groups:
        for name, term in getattr(trained.observations, group).terms.items():
            if "measured" in inspect.signature(term.func).parameters:
                age = sim.observation_age_s if term.params.get("measured") else None
                ages[f"{group}.{name}"] = age or sim.timestep
    if len(set(ages.values())) > 1:
        listed = ", ".join(f"{name} {1e3 * age:g} ms" for name, age in ages.items())
        raise UserError(f"a contract has one age for all that is seen, but here they differ: {listed}.")
    return next(iter(ages.values()), sim.timestep)


def _group(name: str, cfg: ObservationGroupCfg, env: ManagerBasedRlEnv) -> contracts.ObservationGroup:
    return contracts.ObservationGroup(
        name=name,
        history=cfg.history,
        layout="terms in this order; of each term all frames, oldest first",
        start="all frames equal the first one",
        terms=tuple(_term(f"{name}.{n}", n, term, env, cfg.enable_corruption) for n, term in cfg.terms.items()),
    )


def _term(where: str, name: str, cfg: ObservationTermCfg, env: ManagerBasedRlEnv, noisy: bool) -> contracts.Term:
    function = getattr(cfg.func, "__qualname__", str(cfg.func))
    quantity = getattr(cfg.func, "measured_quantity", None)
    if quantity is None:
        raise UserError(
            f"observation '{where}': {function} does not say what it measures, so a contract could not describe it; "
            f"declare it with @measured_as, as '{CUSTOM}' if only your own player computes it."
        )
    common = {"name": name, "quantity": quantity, "scale": cfg.scale, "training_noise": cfg.noise if noisy else 0.0}
    if quantity == CUSTOM:
        value = first_value("observation", where, bind("observation", where, cfg, env), env)
        meaning = (inspect.getdoc(cfg.func) or "").partition("\n\n")[0].replace("\n", " ")
        return contracts.Term(meaning=meaning, frame="", unit=(), components=(), shape=tuple(value.shape[1:]), **common)
    if quantity not in QUANTITIES:
        raise UserError(f"observation '{where}': {unknown('quantity', quantity, (*QUANTITIES, CUSTOM))}")
    # `measured` is carried, as the age of what is seen.
    if others := [name for name in cfg.params if name != "measured"]:
        raise UserError(f"observation '{where}': a contract cannot carry its parameters ({', '.join(others)}).")
    return described(robot=env.robot, **common)


def _commands(cfg: VelocityCommandCfg) -> contracts.Commands:
    forward, left, turn = cfg.bounds()
    return contracts.Commands(
        forward_m_s=forward,
        left_m_s=left,
        yaw_rate_rad_s=turn,
        trained_to_stand=cfg.standing_share > 0.0,
        held_s=cfg.resample_s,
        steering=steering(cfg.heading_gain, cfg.lateral_gain, cfg.yaw_rate_limit),
    )


def _fall(terms: Terms[Any]) -> contracts.Fall:
    """Limits of the terminations that apply to any robot."""

    def limit(function: Any, parameter: str) -> float | None:
        found = [term.params[parameter] for _, term in terms.items() if term.func is function]
        return float(found[0]) if found else None

    return contracts.Fall(limit(terminations.root_too_low, "height"), limit(terminations.tilted, "degrees"))
