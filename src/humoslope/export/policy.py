"""Export of a trained policy: network, contract, robot model, and deploy.yaml for Unitree's deployment."""

from __future__ import annotations

import hashlib
import inspect
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tensordict import TensorDict

import humoslope
from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.deploy.quantities import CUSTOM, QUANTITIES
from humoslope.deploy.unitree import deploy_yaml
from humoslope.env import EnvCfg, ManagerBasedRlEnv, SimCfg
from humoslope.errors import UserError, unknown
from humoslope.evaluation.common import rollout
from humoslope.export.onnx import OUTPUT, largest_difference, network_inputs, translate, with_metadata
from humoslope.files import write_atomically, write_text
from humoslope.learning.policy import Actor, Provenance
from humoslope.managers import ObservationGroupCfg, ObservationTermCfg, Terms, VelocityCommandCfg
from humoslope.managers.terms import bind, first_value
from humoslope.mdp import terminations
from humoslope.provenance import git_state
from humoslope.seal import SUMS, write_sums

# Paths at which Unitree's deployment looks for them in a policy folder.
ONNX, DEPLOY = "exported/policy.onnx", "params/deploy.yaml"
MODEL = "model.xml"
TOLERANCE = 1e-5
"""Largest difference between an action of the ONNX file and torch's."""

CONVENTIONS = (
    "SI units: m, s, rad, kg, N, Nm; degrees where a name ends in _deg. Right-handed frames, x forward, y left, z up; "
    "quaternions w first. Joints, actions, and observations of one number for each joint are in the order of 'joints'."
)


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
    content = with_metadata(translate(actor, observations), make_metadata(actor, env, trained))
    difference = largest_difference(content, actor, observations)
    if not difference <= TOLERANCE:
        raise UserError(
            f"the ONNX file differs from torch by {difference:.2g} on {len(observations)} observations, more than "
            f"{TOLERANCE:g}; nothing was written."
        )
    model = robot_xml(env)
    contract = make_contract(actor, env, trained, observations, content, model)
    (folder / SUMS).unlink(missing_ok=True)  # of an earlier export, of which the files are replaced one by one
    write_atomically(folder / ONNX, lambda path: path.write_bytes(content))
    write_text(folder / MODEL, model)
    try:
        write_text(folder / DEPLOY, deploy_yaml(contract))
        without = None
    except UserError as error:
        (folder / DEPLOY).unlink(missing_ok=True)  # of an earlier export
        without = str(error)
    write_text(folder / contracts.FILE, contract.to_json())
    write_sums(folder, [ONNX, MODEL, contracts.FILE, *([] if without else [DEPLOY])])
    return Exported(contract, difference, len(observations), without)


def make_metadata(actor: Actor, env: ManagerBasedRlEnv, trained: EnvCfg) -> dict[str, str]:
    """Returns what a program that knows no contract needs to run the network, under mjlab's keys; lists are separated
    by commas.

    `observation_history`, the control steps that each observation spans, is ours. mjlab writes three decimals, this
    every digit.

    Args:
        actor: As in `export`.
        env: As in `export`.
        trained: As in `export`.
    """
    joints = _joints(env, trained.actions.scale_factor)
    groups = [_group(name, getattr(trained.observations, name), env) for name in actor.spec.groups]
    lists: dict[str, list[Any]] = {
        "joint_names": [joint.name for joint in joints],
        "joint_stiffness": [joint.stiffness_nm_rad for joint in joints],
        "joint_damping": [joint.damping_nms_rad for joint in joints],
        "default_joint_pos": [joint.default_rad for joint in joints],
        "action_scale": [joint.action_scale_rad for joint in joints],
        "command_names": ["velocity"],
        "observation_names": [term.name for group in groups for term in group.terms],
        "observation_history": [group.history for group in groups for _ in group.terms],
    }
    return {"run_path": actor.provenance.path.name} | {
        name: ",".join(map(str, values)) for name, values in lists.items()
    }


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
    _check_imu(env)
    return Contract(
        format="humoslope-policy",
        version=2,
        exported_by=f"humoslope {humoslope.__version__}, {git_state().splitlines()[0]}",
        conventions=CONVENTIONS,
        training=_training(actor.provenance),
        network=contracts.Network(
            file=ONNX,
            sha256=hashlib.sha256(onnx).hexdigest(),
            inputs=network_inputs(actor, observations),
            output=contracts.NetworkOutput(OUTPUT, (1, robot.num_joints)),
        ),
        robot=contracts.RobotModel(
            name=robot.name,
            file=MODEL,
            sha256=hashlib.sha256(model.encode("utf-8")).hexdigest(),
            root_body=robot.root_body,
            foot_geoms=tuple(geom for side in robot.foot_geoms for geom in side),
            default_root_height_m=robot.default_root_height,
        ),
        timing=contracts.Timing(
            control_step_s=env.step_dt,
            physics_step_s=sim.timestep,
            observation_age_s=_observation_age(actor, trained, sim),
        ),
        action=contracts.Action(
            target="default_rad + action_scale_rad * output",
            torque="stiffness_nm_rad * (target - position) - damping_nms_rad * velocity, within +-effort_limit_nm",
        ),
        joints=_joints(env, trained.actions.scale_factor),
        observations=tuple(_group(name, getattr(trained.observations, name), env) for name in actor.spec.groups),
        commands=_commands(trained.command),
        fall=_fall(trained.terminations),
    )


def robot_xml(env: ManagerBasedRlEnv) -> str:
    """Returns the robot alone as MJCF with the physics options of `env`; actuators and sensors are in the contract.

    MuJoCo writes six digits.

    Raises:
        UserError: If the robot needs other files.
    """
    spec = env.robot.make_spec()
    if spec.meshes:
        raise UserError(f"{env.robot.name}: its model needs mesh files, which an export does not carry.")
    # The reader builds actuators from the contract's numbers; keyframes with controls would not match without them.
    for part in (*spec.actuators, *spec.sensors, *spec.keys):
        spec.delete(part)
    spec.option.timestep = env.sim.model.opt.timestep
    spec.option.cone = env.sim.model.opt.cone
    spec.compile()
    return spec.to_xml()


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


def _check_imu(env: ManagerBasedRlEnv) -> None:
    site, root = env.sim.model.site(env.robot.imu_site), env.sim.model.body(env.robot.root_body)
    if site.bodyid[0] != root.id or not np.allclose(site.quat, (1.0, 0.0, 0.0, 0.0), atol=1e-6):
        raise UserError(
            f"{env.robot.name}: site '{site.name}' must belong to '{root.name}' and be parallel to its axes, "
            "because a contract gives the angular velocity in the root's frame."
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
            f"declare it with @measured_as, as '{CUSTOM}' if no player but your own shall compute it."
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
    known = QUANTITIES[quantity]
    components = known.components or env.robot.joint_names
    return contracts.Term(
        meaning=known.meaning,
        frame=known.frame,
        unit=known.unit,
        components=components,
        shape=(len(components),),
        **common,
    )


def _joints(env: ManagerBasedRlEnv, scale_factor: float) -> tuple[contracts.Joint, ...]:
    robot, model = env.robot, env.sim.model
    return tuple(
        contracts.Joint(
            name=name,
            default_rad=robot.default_joint_pos[i],
            action_scale_rad=robot.action_scale[i] * scale_factor,
            stiffness_nm_rad=robot.stiffness[i],
            damping_nms_rad=robot.damping[i],
            effort_limit_nm=robot.effort_limit[i],
            armature_kg_m2=float(model.dof_armature[model.joint(name).dofadr[0]]),
            range_rad=(float(model.joint(name).range[0]), float(model.joint(name).range[1])),
        )
        for i, name in enumerate(robot.joint_names)
    )


def _commands(cfg: VelocityCommandCfg) -> contracts.Commands:
    forward, left, turn = cfg.bounds()
    return contracts.Commands(
        forward_m_s=forward,
        left_m_s=left,
        yaw_rate_rad_s=turn,
        trained_to_stand=cfg.standing_share > 0.0,
        held_s=cfg.resample_s,
        steering=contracts.Steering(
            law="clamp(heading_gain_per_s * wrap(-lateral_gain_rad_m * place_left_of_course - yaw), +-limit_rad_s)",
            heading_gain_per_s=cfg.heading_gain,
            lateral_gain_rad_m=cfg.lateral_gain,
            limit_rad_s=cfg.yaw_rate_limit,
        ),
    )


def _fall(terms: Terms[Any]) -> contracts.Fall:
    """Limits of the terminations that apply to any robot."""

    def limit(function: Any, parameter: str) -> float | None:
        found = [term.params[parameter] for _, term in terms.items() if term.func is function]
        return float(found[0]) if found else None

    return contracts.Fall(limit(terminations.root_too_low, "height"), limit(terminations.tilted, "degrees"))
