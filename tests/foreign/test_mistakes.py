"""A file that cannot be imported is refused in one sentence, and nothing is written."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import onnx
import pytest
import yaml
from onnx import TensorProto, helper

from humoslope.cli import main
from humoslope.errors import UserError
from humoslope.foreign import holosoma
from humoslope.registry import content_of
from tests.foreign.linear import linear, matrix
from tests.foreign.test_formats import MJLAB, deploy_yaml, holosoma_metadata, mjlab_metadata, terms


@pytest.fixture
def refusal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """refusal(path): the sentence with which `humoslope import` refuses a file."""

    def ask(path: Path | str, *options: str) -> str:
        out = tmp_path / "out"
        assert main(["import", str(path), "--out", str(out), *options]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert not out.exists()
        return said

    return ask


def network(tmp_path: Path, metadata: dict[str, str], width: int = 99) -> Path:
    path = tmp_path / "guest.onnx"
    path.write_bytes(linear(matrix(width), metadata))
    return path


def without(metadata: dict[str, str], key: str) -> dict[str, str]:
    return {name: value for name, value in metadata.items() if name != key}


MJLAB_FILE = mjlab_metadata(MJLAB)


@pytest.mark.parametrize(
    ("metadata", "said"),
    [
        ({}, "does not say what it reads: it has neither 'joint_names' of mjlab nor 'dof_names' of holosoma"),
        (
            mjlab_metadata([*MJLAB, "height_scan"]),
            "its observation 'height_scan' is not known here; known are actions,",
        ),
        (mjlab_metadata([*MJLAB, "command"]), "has an observation twice"),
        (
            mjlab_metadata(MJLAB[1:]),
            "reads 99 numbers, but its observations have 96: base_ang_vel 3, projected_gravity",
        ),
        (without(MJLAB_FILE, "action_scale"), "has metadata of mjlab, but they lack 'action_scale'"),
        (MJLAB_FILE | {"joint_damping": "1,2"}, "has 2 numbers of damping for 29 joints"),
        (MJLAB_FILE | {"joint_damping": "soft"}, "its joint_damping must be finite numbers"),
        (MJLAB_FILE | {"observation_terms_scale": "1"}, "observation_terms_scale has 1 entries for 7 observations"),
        (
            MJLAB_FILE | {"joint_names": MJLAB_FILE["joint_names"].replace("left_knee_joint", "left_nee_joint")},
            "joint of unitree_g1_solid 'left_nee_joint' does not exist; did you mean 'left_knee_joint'?",
        ),
        (
            MJLAB_FILE | {"joint_names": MJLAB_FILE["joint_names"].replace("left_knee_joint", "left_elbow_joint")},
            "lists a joint twice",
        ),
        (holosoma_metadata(command_ranges=None), "is of holosoma, but not of its walking"),
        (
            holosoma_metadata(dof_names=["Head_yaw"]),
            "for a robot that is not known here; its first joint is 'Head_yaw'",
        ),
        (without(holosoma_metadata(), "kp"), "has metadata of holosoma, but 'kp' is missing or broken"),
        (holosoma_metadata(), "reads 99 numbers, but its observations have 100: actions 29, base_ang_vel 3,"),
    ],
)
def test_metadata_that_cannot_be_followed_are_named(
    refusal: Callable[..., str], tmp_path: Path, metadata: dict[str, str], said: str
) -> None:
    path = network(tmp_path, metadata)
    answer = refusal(path)
    assert said in answer
    assert f"'{path}'" in answer


def test_a_robot_of_holosoma_that_is_registered_twice_is_not_chosen_between(tmp_path: Path) -> None:
    told = holosoma_metadata()
    (robot,) = content_of(holosoma.HolosomaRobot)
    with pytest.raises(UserError, match="for a robot whose conventions are registered more than once"):
        holosoma.read(told, tmp_path / "guest.onnx", [robot, dataclasses.replace(robot, action_bound=1.0)])


def change(*keys: str, to: Any) -> Callable[[dict[str, Any]], None]:
    def apply(content: dict[str, Any]) -> None:
        *outer, last = keys
        for key in outer:
            content = content[key]
        if to is None:
            del content[last]
        else:
            content[last] = to

    return apply


ACTION = ("actions", "JointPositionAction")


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (
            change("observations", "gait_phase", to={}),
            "its observation 'gait_phase' is not known here; known are base_",
        ),
        (change("observations", "base_ang_vel", "scale", to=[1.0, 2.0]), "'base_ang_vel' has 2 scales for 3 numbers"),
        (
            change("observations", "base_ang_vel", "history_length", to=3),
            "reads 96 numbers, but its observations have 102",
        ),
        (change("step_dt", to=None), "is not a deploy.yaml of Unitree's: it lacks 'step_dt'"),
        (change("observations", to=3), "is not a deploy.yaml of Unitree's: it has another form"),
        (change("joint_ids_map", to=[0, 1]), "its joint_ids_map has 2 motors, and the robot 29"),
        (change("stiffness", to=[1.0]), "stiffness and damping must have a number for each of 29 motors"),
        (change(*ACTION, "joint_names", to=["left_hand"]), "the robot has no joint 'left_hand'"),
        (change(*ACTION, "offset", to=[0.0] * 29), "the offset of its actions is not default_joint_pos"),
        (change(*ACTION, "clip", to=[[-1.0, 1.0]] * 29), "its actions have 'clip', which a contract cannot say"),
        (change("step_dt", to="20 ms"), "its step_dt must be finite numbers"),
        (change("stiffness", to=[float("inf")] * 29), "its stiffness must be finite numbers"),
        (change("damping", to=3.0), "its damping must be finite numbers"),
        (change("observations", "base_ang_vel", "scale", to=float("nan")), "its scale must be finite numbers"),
        (change("observations", "base_ang_vel", "clip", to=[-1.0, float("nan")]), "its clip must be numbers"),
        (change("observations", "base_ang_vel", "clip", to=[-1.0, 0.0, 1.0]), "of Unitree's: it has another form"),
        (change("observations", "base_ang_vel", "history_length", to="five"), "of Unitree's: it has another form"),
        (change("joint_ids_map", to=["left"] * 29), "of Unitree's: it has another form"),
        (
            change("actions", to={"JointVelocityAction": {}}),
            "its actions are JointVelocityAction; only JointPositionAction",
        ),
    ],
)
def test_a_deploy_yaml_that_cannot_be_followed_is_named(
    refusal: Callable[..., str], tmp_path: Path, spoil: Callable[[Any], None], said: str
) -> None:
    path = deploy_yaml(tmp_path / "v0", terms(*[1] * 6))
    content = yaml.safe_load(path.read_text())
    spoil(content)
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    assert said in refusal(path)


def test_joints_in_another_order_than_the_motors_are_named(refusal: Callable[..., str], tmp_path: Path) -> None:
    path = deploy_yaml(tmp_path / "v0", terms(*[1] * 6))
    content = yaml.safe_load(path.read_text())
    names = json.loads(holosoma_metadata()["dof_names"])
    content["actions"]["JointPositionAction"]["joint_names"] = [names[1], names[0], *names[2:]]
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    assert f"joint 0 of its actions is '{names[1]}', but by joint_ids_map '{names[0]}'" in refusal(path)


def test_files_that_are_none_are_refused(refusal: Callable[..., str], tmp_path: Path) -> None:
    assert "'nobody' is neither a file nor a published policy; of these there are: holosoma-fastsac" in refusal(
        "nobody"
    )
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"no network")
    assert "is no ONNX network: " in refusal(broken)
    (tmp_path / "empty").mkdir()
    assert "has no deploy.yaml or params/deploy.yaml; name a file." in refusal(tmp_path / "empty")
    path = deploy_yaml(tmp_path / "v0", terms(*[1] * 6))
    assert "--network belongs to a deploy.yaml" in refusal(broken, "--network", str(path))
    (tmp_path / "v0" / "exported" / "policy.onnx").unlink()
    assert "there is no network beside" in refusal(path)
    path.write_text("a: [")
    assert "is no readable YAML file" in refusal(path, "--network", str(broken))
    assert "robot 'unitree_g2' does not exist; did you mean 'unitree_g1'?" in refusal(broken, "--robot", "unitree_g2")


def test_a_network_of_several_inputs_or_unnamed_outputs_is_refused(refusal: Callable[..., str], tmp_path: Path) -> None:
    def write(inputs: list[str], outputs: list[str]) -> Path:
        ends = [
            [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 99]) for name in names]
            for names in (inputs, outputs)
        ]
        nodes = [helper.make_node("Identity", [inputs[0]], [name]) for name in outputs]
        model = helper.make_model(helper.make_graph(nodes, "several", *ends), ir_version=7)
        helper.set_model_props(model, MJLAB_FILE)
        path = tmp_path / "several.onnx"
        onnx.save(model, path)
        return path

    assert "has the inputs obs, time_step; only one can be fed" in refusal(write(["obs", "time_step"], ["actions"]))
    assert "has the outputs mean, std; none is called 'actions'" in refusal(write(["obs"], ["mean", "std"]))
    assert "gives 99 numbers for 29 joints" in refusal(write(["obs"], ["std", "actions"]))
