"""An exported network acts as the trained one, and what cannot be described is not exported."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import onnxruntime as ort
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.deploy.quantities import QUANTITIES
from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.export import policy as exporting
from humoslope.export.policy import describe, export, record_observations, robot_xml
from humoslope.learning.policy import Actor, load_actor, read_provenance
from humoslope.managers import ObservationTermCfg
from humoslope.mdp import observations
from humoslope.mdp.declare import measured_as
from humoslope.registry import all_tasks, build_task
from robots.unitree_g1 import UNITREE_G1

Change = Callable[[EnvCfg], None]


@pytest.fixture(scope="module")
def env(make_stage1: Callable[..., ManagerBasedRlEnv]) -> ManagerBasedRlEnv:
    return make_stage1(4)


@pytest.fixture(scope="module")
def actor(env: ManagerBasedRlEnv, stage1_checkpoint: Path) -> Actor:
    return load_actor(stage1_checkpoint, env)


@pytest.fixture(scope="module")
def described(stage1_checkpoint: Path, make_stage1: Callable[..., ManagerBasedRlEnv]) -> Callable[[Change], Contract]:
    """described(change): the contract of Stage I after `change(cfg)`."""

    def make(change: Change) -> Contract:
        env = make_stage1(1, change)
        return describe(read_provenance(stage1_checkpoint), env, env.cfg, "0" * 64)

    return make


def test_the_file_acts_as_torch_on_the_noisy_observations_of_training(
    exported: Path, env: ManagerBasedRlEnv, actor: Actor
) -> None:
    seen = record_observations(env, actor, 1.0)
    assert seen.shape == (200, 480)
    session = ort.InferenceSession(exported / "exported" / "policy.onnx", providers=["CPUExecutionProvider"])
    given = np.concatenate([session.run(["actions"], {"obs": row[None]})[0] for row in seen.numpy()])
    expected = actor(TensorDict({"actor": seen}, batch_size=[200]))
    torch.testing.assert_close(torch.from_numpy(given), expected, rtol=0.0, atol=1e-5)
    assert expected.abs().max() > 0.5


def test_the_file_is_whole_and_of_one_row(exported: Path) -> None:
    files = sorted(str(path.relative_to(exported)) for path in exported.rglob("*") if path.is_file())
    assert files == ["exported/policy.onnx", "model.xml", "params/deploy.yaml", "policy.json"]
    # Bytes alone: weights in another file could not be found.
    session = ort.InferenceSession((exported / files[0]).read_bytes(), providers=["CPUExecutionProvider"])
    assert [(end.name, end.shape) for end in session.get_inputs()] == [("obs", [1, 480])]
    assert [(end.name, end.shape) for end in session.get_outputs()] == [("actions", [1, 29])]


def test_the_contract_says_where_the_policy_comes_from(exported: Path, stage1_checkpoint: Path) -> None:
    raw = json.loads((exported / contracts.FILE).read_text())
    assert raw["training"]["sha256"] == hashlib.sha256(stage1_checkpoint.read_bytes()).hexdigest()
    assert raw["training"]["task"] == "HumoSlope-Stage1-Unitree-G1"
    assert raw["training"]["harness"] == 0.0
    assert raw["training"]["started_from"] is None
    assert raw["network"]["sha256"] == hashlib.sha256((exported / "exported" / "policy.onnx").read_bytes()).hexdigest()


def test_the_model_file_is_the_robot(env: ManagerBasedRlEnv) -> None:
    """Six digits are what MuJoCo writes; drives, sensors and ground are the contract's and the player's."""
    written = mujoco.MjModel.from_xml_string(robot_xml(env))
    original = UNITREE_G1.make_spec().compile()
    assert (written.nu, written.nsensor, written.nkey) == (0, 0, 0)
    assert (written.nq, written.ngeom, written.nsite) == (original.nq, original.ngeom, original.nsite)
    for field in ("body_mass", "body_inertia", "body_ipos", "jnt_range", "geom_size", "geom_contype", "geom_friction"):
        np.testing.assert_allclose(getattr(written, field), getattr(original, field), rtol=1e-5, atol=1e-7)
    assert (written.opt.timestep, written.opt.integrator) == (env.cfg.sim.timestep, original.opt.integrator)
    assert written.opt.cone == original.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC


def test_overrides_of_a_task_reach_the_contract(described: Callable[[Change], Contract]) -> None:
    def change(cfg: EnvCfg) -> None:
        cfg.actions.scale_factor = 0.5
        cfg.observations.actor.history = 2
        cfg.command.speed, cfg.command.yaw_rate, cfg.command.standing_share = (0.1, 0.2), (-0.1, 0.5), 0.0
        cfg.terminations.tilted = None

    contract = described(change)
    assert contract.joints[0].action_scale_rad == 0.5 * UNITREE_G1.action_scale[0]
    assert contract.network.inputs == 2 * 96
    assert contract.commands.forward_m_s == (0.1, 0.2)
    assert contract.commands.yaw_rate_rad_s == (-0.3, 0.5)  # what was drawn and what steering asked for
    assert not contract.commands.stands
    assert contract.fall == contracts.Fall(0.4, None)


def undescribed(env: Any) -> Tensor:
    return env.signals.joint_pos


@measured_as("smell")
def mistyped(env: Any) -> Tensor:
    return env.signals.joint_pos


@measured_as("joint_velocity")
def delayed(env: Any, steps: int) -> Tensor:
    return env.signals.joint_vel


@pytest.mark.parametrize(
    ("term", "said"),
    [
        (ObservationTermCfg(undescribed), "observation 'extra': undescribed does not say what it measures"),
        (ObservationTermCfg(observations.base_lin_vel), "base_lin_vel does not say what it measures"),
        (ObservationTermCfg(mistyped), "observation 'extra': quantity 'smell' does not exist"),
        (ObservationTermCfg(delayed, {"steps": 1}), "a contract cannot carry its parameters (steps)"),
    ],
)
def test_an_observation_that_no_one_else_could_build_is_not_exported(
    described: Callable[[Change], Contract], term: ObservationTermCfg, said: str
) -> None:
    def change(cfg: EnvCfg) -> None:
        cfg.observations.actor.terms.extra = term

    with pytest.raises(UserError) as error:
        described(change)
    assert said in str(error.value)


def test_every_registered_task_has_an_actor_that_can_be_described() -> None:
    for name in all_tasks():
        cfg = build_task(name).env
        for term_name, term in cfg.observations.actor.terms.items():
            assert exporting._term(term_name, term, cfg.scene.robot, True).quantity in QUANTITIES


def test_a_robot_whose_gyroscope_is_turned_is_not_exported(env: ManagerBasedRlEnv, monkeypatch: Any) -> None:
    monkeypatch.setitem(vars(env), "robot", exporting.Robot(**(vars(UNITREE_G1) | {"imu_site": "imu_in_torso"})))
    with pytest.raises(UserError, match="site 'imu_in_torso' must lie in 'pelvis' and along its axes"):
        exporting._check_imu(env)


def test_a_network_that_differs_from_torch_is_not_written(
    exported: Path, env: ManagerBasedRlEnv, stage1_checkpoint: Path, monkeypatch: Any, tmp_path: Path
) -> None:
    other = load_actor(stage1_checkpoint, env)
    with torch.no_grad():
        next(other.module.mlp.parameters()).mul_(1.01)
    content = (exported / "exported" / "policy.onnx").read_bytes()
    monkeypatch.setattr(exporting, "translate", lambda actor: content)
    seen = record_observations(env, other, 0.1)
    with pytest.raises(UserError, match=r"differs from torch by .* on 20 observations, more than 1e-05; nothing was"):
        export(other, env, env.cfg, seen, tmp_path / "out")
    assert not (tmp_path / "out").exists()
