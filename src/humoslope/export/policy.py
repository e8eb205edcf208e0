"""A trained policy as files that run without this framework: network, contract, robot model, Unitree's deploy.yaml."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

import humoslope
from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.deploy.quantities import QUANTITIES
from humoslope.deploy.unitree import deploy_yaml
from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.errors import UserError, unknown
from humoslope.evaluation.common import rollout
from humoslope.export.onnx import INPUT, OUTPUT, largest_difference, translate
from humoslope.files import write_atomically, write_text
from humoslope.learning.policy import GROUP, Actor, Provenance
from humoslope.managers import ObservationTermCfg, Terms, VelocityCommandCfg
from humoslope.mdp import terminations
from humoslope.provenance import git_state
from humoslope.scene.robot import Robot

# Where Unitree's deployment looks for them in a policy folder.
ONNX, DEPLOY = "exported/policy.onnx", "params/deploy.yaml"
MODEL = "model.xml"
TOLERANCE = 1e-5
"""How far an action of the ONNX file may be from torch's."""

CONVENTIONS = (
    "SI units: m, s, rad, kg, N, Nm; degrees where a name ends in _deg. Right-handed frames, x forward, y left, z up; "
    "quaternions w first. Joints, actions, and observations of one number for each joint are in the order of 'joints'."
)


@dataclass(frozen=True)
class Exported:
    """What came out.

    Attributes:
        contract: As written.
        difference: Largest difference between an action of the ONNX file and torch's.
        compared: Observations for which both were computed.
    """

    contract: Contract
    difference: float
    compared: int


def record_observations(env: ManagerBasedRlEnv, actor: Actor, seconds: float) -> Tensor:
    """What the actor sees while it drives all worlds for `seconds`, [K, d]."""
    seen: list[Tensor] = []

    def act(obs: TensorDict) -> Tensor:
        seen.append(obs[GROUP])
        return actor(obs)

    rollout(env, act, seconds, lambda failed, ended: None)
    return torch.cat(seen)


def export(actor: Actor, env: ManagerBasedRlEnv, trained: EnvCfg, observations: Tensor, folder: Path) -> Exported:
    """Writes the policy into `folder`; the contract last, so that a folder with one is whole.

    Args:
        env: An environment of the task with the physics of the evaluation.
        trained: The environment as it was trained in, for what the policy was asked there.
        observations: [K, d] of a real rollout, on which the ONNX file must agree with torch.

    Raises:
        UserError: If the contract cannot say what the policy needs, or the ONNX file does something else than torch.
    """
    content = translate(actor)
    difference = largest_difference(content, actor, observations)
    if not difference <= TOLERANCE:
        raise UserError(
            f"the ONNX file differs from torch by {difference:.2g} on {len(observations)} observations, more than "
            f"{TOLERANCE:g}; nothing was written."
        )
    digest = hashlib.sha256(content).hexdigest()
    contract = describe(actor.provenance, env, trained, digest)
    write_atomically(folder / ONNX, lambda path: path.write_bytes(content))
    write_text(folder / MODEL, robot_xml(env))
    write_text(folder / DEPLOY, deploy_yaml(contract))
    write_text(folder / contracts.FILE, contract.to_json())
    return Exported(contract, difference, len(observations))


def describe(provenance: Provenance, env: ManagerBasedRlEnv, trained: EnvCfg, sha256: str) -> Contract:
    """The contract of a policy.

    Args:
        env: As in `export`.
        trained: As in `export`.
        sha256: Of the ONNX file.

    Raises:
        UserError: If an observation has no description, or the robot is not as the descriptions take it to be.
    """
    robot, sim, group = env.robot, env.cfg.sim, trained.observations.actor
    _check_imu(env)
    terms = tuple(_term(name, term, robot, group.enable_corruption) for name, term in group.terms.items())
    return Contract(
        format="humoslope-policy",
        version=contracts.VERSION,
        exported_by=f"humoslope {humoslope.__version__}, {git_state().splitlines()[0]}",
        conventions=CONVENTIONS,
        training=_training(provenance),
        network=contracts.Network(
            file=ONNX,
            sha256=sha256,
            input=INPUT,
            inputs=group.history * sum(len(term.components) for term in terms),
            output=OUTPUT,
            outputs=robot.num_joints,
        ),
        robot=contracts.RobotModel(
            name=robot.name,
            file=MODEL,
            root_body=robot.root_body,
            foot_geoms=tuple(geom for side in robot.foot_geoms for geom in side),
            default_root_height_m=robot.default_root_height,
        ),
        timing=contracts.Timing(
            control_step_s=env.step_dt, physics_step_s=sim.timestep, observation_age_s=sim.timestep
        ),
        action=contracts.Action(
            target="default_rad + action_scale_rad * output",
            torque="stiffness_nm_rad * (target - position) - damping_nms_rad * velocity, within +-effort_limit_nm",
        ),
        joints=_joints(env, trained.actions.scale_factor),
        observation=contracts.Observation(
            history=group.history,
            layout="terms in this order; of each term all frames, oldest first",
            start="all frames equal the first one",
            terms=terms,
        ),
        commands=_commands(trained.command),
        fall=_fall(trained.terminations),
    )


def robot_xml(env: ManagerBasedRlEnv) -> str:
    """The robot alone as MJCF with the physics options of `env`; the contract says how it is driven and measured.

    MuJoCo writes six digits.

    Raises:
        UserError: If it needs other files.
    """
    spec = env.robot.make_spec()
    if spec.meshes:
        raise UserError(f"{env.robot.name}: its model needs mesh files, which an export does not carry.")
    # By the contract's own numbers whoever reads it makes actuators; a key without them would not fit.
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
            f"{env.robot.name}: site '{site.name}' must lie in '{root.name}' and along its axes, "
            "because a contract gives the angular velocity in the root's frame."
        )


def _term(name: str, term: ObservationTermCfg, robot: Robot, noisy: bool) -> contracts.Term:
    function = getattr(term.func, "__qualname__", str(term.func))
    quantity = getattr(term.func, "measured_quantity", None)
    if quantity is None:
        raise UserError(
            f"observation '{name}': {function} does not say what it measures, so a contract could not describe it; "
            "declare it with @measured_as."
        )
    if quantity not in QUANTITIES:
        raise UserError(f"observation '{name}': {unknown('quantity', quantity, QUANTITIES)}")
    if term.params:
        raise UserError(f"observation '{name}': a contract cannot carry its parameters ({', '.join(term.params)}).")
    known = QUANTITIES[quantity]
    return contracts.Term(
        name=name,
        quantity=quantity,
        meaning=known.meaning,
        frame=known.frame,
        unit=known.unit,
        components=known.components or robot.joint_names,
        scale=term.scale,
        training_noise=term.noise if noisy else 0.0,
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
    low, high = cfg.yaw_rate
    if cfg.heading_share > 0.0:
        low, high = min(low, -cfg.yaw_rate_limit), max(high, cfg.yaw_rate_limit)
    return contracts.Commands(
        forward_m_s=cfg.speed,
        left_m_s=cfg.lateral,
        yaw_rate_rad_s=(low, high),
        stands=cfg.standing_share > 0.0,
        held_s=cfg.resample_s,
        steering=contracts.Steering(
            law="clamp(heading_gain_per_s * wrap(-lateral_gain_rad_m * place_left_of_course - yaw), +-limit_rad_s)",
            heading_gain_per_s=cfg.heading_gain,
            lateral_gain_rad_m=cfg.lateral_gain,
            limit_rad_s=cfg.yaw_rate_limit,
        ),
    )


def _fall(terms: Terms[Any]) -> contracts.Fall:
    """The limits of the terminations that any robot can be judged by."""

    def limit(function: Any, parameter: str) -> float | None:
        found = [term.params[parameter] for _, term in terms.items() if term.func is function]
        return float(found[0]) if found else None

    return contracts.Fall(limit(terminations.root_too_low, "height"), limit(terminations.tilted, "degrees"))
