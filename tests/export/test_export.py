"""An exported network acts as the trained one, and a policy that cannot be described is not exported."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import onnx
import onnxruntime as ort
import pytest
import torch
from rsl_rl.models import CNNModel, MLPModel
from tensordict import TensorDict
from torch import Tensor

from humoslope.cli import main
from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.deploy.player import Player, TrialCfg
from humoslope.deploy.quantities import QUANTITIES
from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.export import policy as exporting
from humoslope.export.folder import model_xml
from humoslope.export.onnx import largest_difference, network_inputs, translate
from humoslope.export.policy import export, make_contract, record_observations
from humoslope.learning.policy import Actor, load_actor
from humoslope.managers import ObservationGroupCfg, ObservationTermCfg, Terms
from humoslope.mdp import observations as observations_of
from humoslope.mdp.declare import measured_as
from humoslope.registry import all_tasks, build_task
from robots.unitree_g1 import UNITREE_G1, UNITREE_G1_SOLID
from tasks.stage1 import SENSED

Change = Callable[[EnvCfg], None]

pytestmark = pytest.mark.usefixtures("shared_operators")


@pytest.fixture(scope="module")
def env(make_stage1: Callable[..., ManagerBasedRlEnv]) -> ManagerBasedRlEnv:
    return make_stage1(4)


@pytest.fixture(scope="module")
def actor(env: ManagerBasedRlEnv, stage1_checkpoint: Path) -> Actor:
    return load_actor(stage1_checkpoint, env)


@pytest.fixture(scope="module")
def described(actor: Actor, make_stage1: Callable[..., ManagerBasedRlEnv]) -> Callable[[Change], Contract]:
    """described(change): the contract of Stage I after `change(cfg)`."""

    def make(change: Change) -> Contract:
        env = make_stage1(1, change)
        return make_contract(actor, env, env.cfg, env.get_observations(), b"network", "<mujoco/>")

    return make


def test_the_file_acts_as_torch_on_the_noisy_observations_of_training(
    exported: Path, env: ManagerBasedRlEnv, actor: Actor
) -> None:
    seen = record_observations(env, actor, 1.0)
    assert seen["actor"].shape == (200, 480)
    assert set(seen.keys()) == {"actor"}
    session = ort.InferenceSession(exported / "exported" / "policy.onnx", providers=["CPUExecutionProvider"])
    given = np.concatenate([session.run(["actions"], {"obs": row[None]})[0] for row in seen["actor"].numpy()])
    expected = actor(seen)
    torch.testing.assert_close(torch.from_numpy(given), expected, rtol=0.0, atol=1e-5)
    assert expected.abs().max() > 0.5


def test_the_file_is_whole_and_of_one_row(exported: Path) -> None:
    files = sorted(str(path.relative_to(exported)) for path in exported.rglob("*") if path.is_file())
    assert files == ["SHA256SUMS", "exported/policy.onnx", "model.xml", "params/deploy.yaml", "policy.json"]
    # Bytes alone: weights in another file could not be found.
    session = ort.InferenceSession((exported / files[1]).read_bytes(), providers=["CPUExecutionProvider"])
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
    option = env.sim.model.opt
    written = mujoco.MjModel.from_xml_string(model_xml(env.robot, option.timestep, option.cone))
    original = UNITREE_G1_SOLID.make_spec().compile()
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
        cfg.command.modes = {}
        cfg.terminations.tilted = None

    contract = described(change)
    assert contract.joints[0].action_scale_rad == 0.5 * UNITREE_G1.action_scale[0]
    assert contract.network.inputs[0].shape == (1, 2 * 96)
    assert contract.commands.forward_m_s == (0.1, 0.2)
    assert contract.commands.yaw_rate_rad_s == (-0.3, 0.5)  # what was drawn and what steering asked for
    assert not contract.commands.trained_to_stand
    assert contract.fall == contracts.Fall(0.4, None)


def measure(*names: str) -> Change:
    """A change after which these observations are 12 ms old, and the others one physics step."""

    def change(cfg: EnvCfg) -> None:
        cfg.sim.observation_age_s = 0.012
        for name in names:
            getattr(cfg.observations.actor.terms, name).params = {"measured": True}
        for name in set(SENSED) - set(names):
            getattr(cfg.observations.actor.terms, name).params = {}

    return change


def test_the_contract_says_how_old_what_is_seen_is(described: Callable[[Change], Contract]) -> None:
    assert described(measure()).timing.observation_age_s == 0.005  # no observation is measured
    assert described(measure(*SENSED)).timing.observation_age_s == 0.012
    with pytest.raises(UserError, match=r"they differ: actor.base_ang_vel 5 ms, actor.projected_gravity 12 ms, "):
        described(measure("projected_gravity", "joint_pos_rel", "joint_vel"))


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
        (ObservationTermCfg(undescribed), "observation 'actor.extra': undescribed does not say what it measures"),
        (ObservationTermCfg(observations_of.base_lin_vel), "base_lin_vel does not say what it measures"),
        (ObservationTermCfg(mistyped), "observation 'actor.extra': quantity 'smell' does not exist"),
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
        if "actor" not in cfg.observations:
            continue  # Gallant's policy sees, and its export says so
        for term in vars(cfg.observations.actor.terms).values():
            assert term.func.measured_quantity in QUANTITIES
            assert set(term.params) <= {"measured"}


def test_a_network_that_differs_from_torch_is_not_written(
    exported: Path, env: ManagerBasedRlEnv, stage1_checkpoint: Path, monkeypatch: Any, tmp_path: Path
) -> None:
    other = load_actor(stage1_checkpoint, env)
    with torch.no_grad():
        next(other.module.mlp.parameters()).mul_(1.01)
    content = (exported / "exported" / "policy.onnx").read_bytes()
    monkeypatch.setattr(exporting, "translate", lambda actor, observations: content)
    seen = record_observations(env, other, 0.1)
    with pytest.raises(UserError, match=r"differs from torch by .* on 20 observations, more than 1e-05; nothing was"):
        export(other, env, env.cfg, seen, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_file_is_the_same_wherever_it_is_made(exported: Path) -> None:
    """The exporter of torch notes stack traces with paths at every node."""
    content = (exported / "exported" / "policy.onnx").read_bytes()
    model = onnx.load_from_string(content)
    assert not any(node.metadata_props for node in model.graph.node)
    assert b"humoslope" not in content
    assert b".py" not in content


def test_the_file_says_how_to_run_it_under_the_keys_of_mjlab(exported: Path) -> None:
    contract = contracts.read(exported)
    session = ort.InferenceSession(exported / "exported" / "policy.onnx", providers=["CPUExecutionProvider"])
    told = session.get_modelmeta().custom_metadata_map

    def numbers(key: str) -> list[float]:
        return [float(text) for text in told[key].split(",")]

    joints, (group,) = contract.joints, contract.observations
    assert told["joint_names"].split(",") == [joint.name for joint in joints]
    assert numbers("joint_stiffness") == [joint.stiffness_nm_rad for joint in joints]
    assert numbers("joint_damping") == [joint.damping_nms_rad for joint in joints]
    assert numbers("default_joint_pos") == [joint.default_rad for joint in joints]
    assert numbers("action_scale") == [joint.action_scale_rad for joint in joints]
    assert told["observation_names"].split(",") == [term.name for term in group.terms]
    assert numbers("observation_history") == [group.history] * len(group.terms)
    assert (told["command_names"], told["run_path"]) == ("velocity", "stage1.pt")


# Several groups of any shape.

ROWS = 7


@pytest.fixture(scope="module")
def observations() -> TensorDict:
    """Two vectors and a map."""
    generator = torch.Generator().manual_seed(0)
    shapes = {"actor": (12,), "extra": (5,), "terrain": (2, 8, 6)}
    tensors = {name: torch.randn(ROWS, *shape, generator=generator) for name, shape in shapes.items()}
    return TensorDict(tensors, batch_size=[ROWS])


class ToyActor:
    """What an export needs of an actor, around any module."""

    def __init__(self, module: torch.nn.Module, *groups: str) -> None:
        self.module, self.spec = module, SimpleNamespace(groups=groups)

    def __call__(self, obs: TensorDict) -> Tensor:
        action: Tensor = self.module(obs).detach()
        return action


def make_actor(module: torch.nn.Module, *groups: str) -> Any:
    return ToyActor(module, *groups)


def mlp(observations: TensorDict, *groups: str) -> MLPModel:
    torch.manual_seed(1)
    model = MLPModel(observations, {"actor": list(groups)}, "actor", 3, (16, 8), obs_normalization=True)
    model.update_normalization(observations)
    return model.eval()


def cnn(observations: TensorDict, *groups: str) -> CNNModel:
    torch.manual_seed(1)
    layers = {"output_channels": [4], "kernel_size": [3], "activation": "elu"}
    model = CNNModel(observations, {"actor": list(groups)}, "actor", 3, (16, 8), obs_normalization=True, cnn_cfg=layers)
    model.update_normalization(observations)
    return model.eval()


class Recurrence(torch.nn.Module):
    """A module that offers no conversion of its own, and reads a map alone."""

    def forward(self, obs: TensorDict) -> Tensor:
        return torch.tanh(obs["terrain"].mean(dim=(2, 3)))


@pytest.mark.parametrize(
    ("make", "groups", "expected"),
    [
        (mlp, ("actor",), {"obs": [1, 12]}),
        (mlp, ("extra", "actor"), {"extra": [1, 5], "actor": [1, 12]}),
        (cnn, ("actor", "terrain"), {"actor": [1, 12], "terrain": [1, 2, 8, 6]}),
        (cnn, ("terrain", "extra", "actor"), {"terrain": [1, 2, 8, 6], "extra": [1, 5], "actor": [1, 12]}),
        (lambda *_: Recurrence(), ("terrain",), {"terrain": [1, 2, 8, 6]}),
    ],
)
def test_a_policy_of_any_groups_is_translated(
    observations: TensorDict, make: Any, groups: tuple[str, ...], expected: dict[str, list[int]]
) -> None:
    actor = make_actor(make(observations, *groups), *groups)
    content = translate(actor, observations)
    session = ort.InferenceSession(content, providers=["CPUExecutionProvider"])
    assert {end.name: end.shape for end in session.get_inputs()} == expected
    assert {end.name: list(end.shape) for end in network_inputs(actor, observations)} == expected
    feeds = [
        {end.name: observations[end.group][k : k + 1].numpy() for end in network_inputs(actor, observations)}
        for k in range(ROWS)
    ]
    given = np.concatenate([session.run(["actions"], feed)[0] for feed in feeds])
    wanted = actor(observations).numpy()
    np.testing.assert_allclose(given, wanted, atol=1e-6)
    assert np.ptp(wanted, axis=0).min() > 1e-3
    assert largest_difference(content, actor, observations) == pytest.approx(np.abs(given - wanted).max())


@measured_as("custom")
def heights(env: Any) -> Tensor:
    """Heights of the ground around the robot,
    in metres.

    Not part of the meaning.
    """
    return env.signals.joint_pos[:, :20].unflatten(1, (1, 4, 5))


def test_an_image_is_exported_as_a_custom_quantity_that_play_refuses(
    actor: Actor,
    make_stage1: Callable[..., ManagerBasedRlEnv],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def look(cfg: EnvCfg) -> None:
        cfg.observations.terrain = ObservationGroupCfg(Terms(map=ObservationTermCfg(heights, scale=0.5)), history=3)

    env = make_stage1(2, look)
    seen = env.get_observations()
    module: Any = cnn_for(seen, env.robot.num_joints)
    both = make_actor(module, "actor", "terrain")
    both.provenance = actor.provenance
    (tmp_path / "params").mkdir()
    (tmp_path / "params" / "deploy.yaml").write_text("of an earlier export")
    result = export(both, env, env.cfg, seen, tmp_path)
    assert result.without_deploy_yaml is not None
    assert "the policy reads the groups actor, terrain" in result.without_deploy_yaml
    assert not (tmp_path / "params" / "deploy.yaml").exists()
    contract = contracts.read(tmp_path)
    assert contract == result.contract
    (term,) = contract.observations[1].terms
    assert (term.name, term.quantity, term.shape, term.scale) == ("map", "custom", (1, 4, 5), 0.5)
    assert term.meaning == "Heights of the ground around the robot, in metres."
    assert contract.network.inputs[1] == contracts.NetworkInput("terrain", "terrain", (1, 3, 4, 5))
    assert main(["play", str(tmp_path), "--headless"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "observation 'terrain.map' is a custom quantity (Heights of the ground around the robot" in said


def cnn_for(observations: TensorDict, outputs: int) -> CNNModel:
    layers = {"output_channels": [4], "kernel_size": [3], "activation": "elu"}
    groups = {"actor": ["actor", "terrain"]}
    return CNNModel(observations, groups, "actor", outputs, (16,), cnn_cfg=layers).eval()


def test_a_policy_of_several_vectors_plays(
    actor: Actor, make_stage1: Callable[..., ManagerBasedRlEnv], tmp_path: Path
) -> None:
    """The player feeds each group by its name: the actions are those of torch on the same observations."""

    def split(cfg: EnvCfg) -> None:
        gyro = ObservationTermCfg(observations_of.base_ang_vel, {"measured": True})
        body = ObservationGroupCfg(Terms(gyro=gyro), history=2)
        cfg.observations = Terms(actor=cfg.observations.actor, body=body)

    env = make_stage1(2, split)
    seen = env.get_observations()
    both = make_actor(mlp_for(seen, env.robot.num_joints), "body", "actor")
    both.provenance = actor.provenance
    export(both, env, env.cfg, seen, tmp_path)
    player = Player(tmp_path, contracts.read(tmp_path), TrialCfg(seconds=0.1))
    player.start()
    fed: list[Any] = []
    policy = player.controller._policy
    player.controller._policy = lambda inputs: fed.append(inputs) or policy(inputs)  # type: ignore[assignment]
    player.step(np.array([0.5, 0.0, 0.0]))
    obs = TensorDict({name: torch.from_numpy(value)[None] for name, value in fed[0].items()}, batch_size=[1])
    assert {name: tuple(value.shape) for name, value in obs.items()} == {"body": (1, 6), "actor": (1, 480)}
    np.testing.assert_allclose(player.controller.last_action, both(obs)[0].numpy(), atol=1e-5)


def mlp_for(observations: TensorDict, outputs: int) -> MLPModel:
    torch.manual_seed(0)
    return MLPModel(observations, {"actor": ["body", "actor"]}, "actor", outputs, (16,)).eval()
