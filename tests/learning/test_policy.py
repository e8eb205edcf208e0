"""An actor comes out of a checkpoint as it was trained, whatever its size."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from humoslope.errors import UserError
from humoslope.learning import checkpoint
from humoslope.learning.policy import PolicySpec, find_checkpoint, load_actor, read_provenance, spec_state
from tests.learning.states import checkpoint_state, env_state

INPUTS, JOINTS = 12, 5


def spec_of(hidden: tuple[int, ...], normalized: bool) -> PolicySpec:
    settings = {
        "hidden_dims": hidden,
        "activation": "elu",
        "obs_normalization": normalized,
        "distribution_cfg": {"class_name": "GaussianDistribution", "init_std": 0.3},
    }
    return PolicySpec("mlp", ("actor",), ((INPUTS,),), JOINTS, settings)


def network(hidden: tuple[int, ...], normalized: bool) -> Any:
    torch.manual_seed(0)
    return spec_of(hidden, normalized).build("cpu")


def observations(count: int, inputs: int = INPUTS) -> TensorDict:
    return TensorDict({"actor": torch.randn(count, inputs)}, batch_size=[count])


def environment(inputs: int = INPUTS, joints: int = JOINTS) -> Any:
    """As much of an environment as loading a policy needs."""
    obs = observations(3, inputs)
    robot = SimpleNamespace(name="robot", num_joints=joints)
    return SimpleNamespace(device=torch.device("cpu"), robot=robot, get_observations=lambda: obs)


def save(
    path: Path, hidden: tuple[int, ...] = (8,), normalized: bool = True, model: Any = None, **changes: Any
) -> Path:
    model = network(hidden, normalized) if model is None else model
    policy = {"spec": spec_state(spec_of(hidden, normalized)), "weights": model.state_dict()}
    env = env_state(harness={"scale": 0.25})
    state = checkpoint_state(policy=policy, iteration=7, total_steps=98304, env=env)
    checkpoint.save(path, state | changes)
    return path


@pytest.mark.parametrize("hidden", [(8,), (16, 8), (512, 256, 128), (256, 128, 128)])
@pytest.mark.parametrize("normalized", [True, False])
def test_networks_of_every_preset_act_as_they_did_in_training(
    tmp_path: Path, hidden: tuple[int, ...], normalized: bool
) -> None:
    model = network(hidden, normalized)
    model.update_normalization(observations(100))
    path = save(tmp_path / "model_7.pt", hidden, normalized, model)
    actor = load_actor(path, environment(), "Walk")
    obs = observations(4)
    torch.testing.assert_close(actor(obs), model.eval()(obs), rtol=0, atol=0)
    torch.testing.assert_close(actor(obs), actor(obs), rtol=0, atol=0)


@pytest.mark.parametrize(
    ("curriculum", "scale", "said"),
    [
        ({}, None, "no harness"),
        ({"harness": {"scale": 0.0}}, 0.0, "which was gone at this checkpoint"),
        ({"harness": {"scale": 0.25}}, 0.25, "still had 25 % of its strength"),
        ({"harness": {"scale": 0.0}, "skills": {"scale": [0.0, 0.5]}}, 0.5, "still had 50 % of its strength"),
    ],
)
def test_a_checkpoint_says_whether_a_harness_helped(
    tmp_path: Path, curriculum: Any, scale: float | None, said: str
) -> None:
    path = save(tmp_path / "model_7.pt", env=env_state(**curriculum))
    provenance = read_provenance(path)
    assert provenance.harness == scale
    assert said in provenance.training
    assert (provenance.task, provenance.iteration, provenance.total_steps) == ("Walk", 7, 98304)
    assert len(provenance.sha256) == 64


def test_a_policy_that_does_not_fit_says_what_it_was_trained_with(tmp_path: Path) -> None:
    path = save(tmp_path / "model_7.pt")
    with pytest.raises(
        UserError, match="trained with 12 observations in group 'actor', but this environment of .* has 20"
    ):
        load_actor(path, environment(inputs=20))
    with pytest.raises(UserError, match="trained with 5 actions, but this environment of robot has 6"):
        load_actor(path, environment(joints=6))
    with pytest.raises(UserError, match="belongs to task 'Walk', not to 'Run'"):
        load_actor(path, environment(), "Run")


def test_a_group_that_the_environment_lacks_is_named(tmp_path: Path) -> None:
    path = save(tmp_path / "model_7.pt")
    bare = environment()
    bare.get_observations = lambda: TensorDict({"acto": torch.zeros(3, INPUTS)}, batch_size=[3])
    with pytest.raises(UserError, match="observation group 'actor' does not exist; did you mean 'acto'"):
        load_actor(path, bare)


def test_weights_of_another_network_than_described_are_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "model_7.pt", (8,), True, network((9,), True))
    with pytest.raises(UserError, match="does not hold the network that it describes"):
        load_actor(path, environment())


def test_a_network_that_is_not_registered_is_named_with_the_nearest_match(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="network 'mpl' does not exist; did you mean 'mlp'"):
        PolicySpec("mpl", ("actor",), ((INPUTS,),), JOINTS, {}).build("cpu")


def test_a_group_without_the_shape_that_its_network_wants_is_refused(tmp_path: Path) -> None:
    flat = PolicySpec("cnn", ("image",), ((4,),), JOINTS, {"cnn_cfg": {"output_channels": [2], "kernel_size": 3}})
    with pytest.raises(UserError, match=r"network 'cnn' cannot be built for groups of image 4"):
        flat.build("cpu")
    image = PolicySpec("mlp", ("image",), ((1, 4, 4),), JOINTS, {})
    with pytest.raises(UserError, match=r"network 'mlp' cannot be built for groups of image 1 x 4 x 4"):
        image.build("cpu")


def test_a_run_folder_stands_for_its_newest_checkpoint(tmp_path: Path) -> None:
    for number in (2, 10):
        save(tmp_path / f"model_{number}.pt")
    assert find_checkpoint(tmp_path) == tmp_path / "model_10.pt"
    assert find_checkpoint(tmp_path / "model_2.pt") == tmp_path / "model_2.pt"
