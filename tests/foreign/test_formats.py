"""A policy of each format, a known matrix, moves the joints as its own framework's rules say."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.foreign.folder import write
from humoslope.foreign.source import Found, find
from robots.unitree_g1 import UNITREE_G1_SOLID
from robots.unitree_g1.policies import HOLOSOMA_G1
from tests.deploy.unitree_rules import Motors, TheirDeployment
from tests.foreign.linear import JOINTS, controller, instants, linear, matrix

NAMES = UNITREE_G1_SOLID.joint_names
SHUFFLED = [int(i) for i in np.random.default_rng(7).permutation(JOINTS)]
GAINS = np.random.default_rng(8).uniform(10.0, 90.0, (2, JOINTS)).tolist()
DEFAULT = np.random.default_rng(9).uniform(-0.3, 0.3, JOINTS).tolist()
ACTION_SCALE = np.random.default_rng(10).uniform(0.1, 0.6, JOINTS).tolist()


def imported(path: Path, out: Path) -> tuple[Contract, Found]:
    """The contract of a file's export, as it is read back."""
    found = find(str(path), None, UNITREE_G1_SOLID)
    written = write(out, found.policy, found.network, UNITREE_G1_SOLID, found.source)
    assert contracts.read(out) == written
    return written, found


def by_name(values: Any, names: Any) -> dict[str, float]:
    return dict(zip(names, values, strict=True))


# Unitree's deployment.

Entry = dict[str, Any]


def entry(size: int, history: int, scale: Any = 1.0, clip: Any = None) -> Entry:
    return {
        "params": {},
        "clip": clip,
        "scale": scale if isinstance(scale, list) else [scale] * size,
        "history_length": history,
    }


def terms(*history: int) -> dict[str, Entry]:
    """All observations in an order of their own, some clipped, some with another scale for each component."""
    gyro, gravity, command, pos, vel, action = history
    return {
        "last_action": entry(JOINTS, action, 0.5, [-0.4, 0.3]),
        "base_ang_vel": entry(3, gyro, 0.2),
        "velocity_commands": entry(3, command, [1.0, 2.0, 0.25]),
        "joint_vel_rel": entry(JOINTS, vel, np.linspace(0.05, -0.1, JOINTS).tolist(), [-1.5, 1.0]),
        "joint_pos_rel": entry(JOINTS, pos),
        "projected_gravity": entry(3, gravity),
    }


def deploy_yaml(folder: Path, observations: Mapping[str, Any], **changes: Any) -> Path:
    """Writes a policy of Unitree's training whose joints are in an order of their own."""
    used = [value for value in observations.values() if isinstance(value, dict)]
    width = sum(len(one["scale"]) * one["history_length"] for one in used)
    content = {
        "joint_ids_map": SHUFFLED,
        "step_dt": 0.04,
        "stiffness": GAINS[0],
        "damping": GAINS[1],
        "default_joint_pos": DEFAULT,
        "commands": {
            "base_velocity": {"ranges": {"lin_vel_x": [-0.5, 1.0], "lin_vel_y": [-0.3, 0.3], "ang_vel_z": [-0.2, 0.2]}}
        },
        "actions": {
            "JointPositionAction": {
                "clip": None,
                "joint_names": [".*"],
                "scale": ACTION_SCALE,
                "offset": DEFAULT,
                "joint_ids": None,
            }
        },
        "observations": dict(observations),
    }
    (folder / "params").mkdir(parents=True)
    (folder / "exported").mkdir()
    (folder / "exported" / "policy.onnx").write_bytes(linear(matrix(width), {}))
    path = folder / "params" / "deploy.yaml"
    path.write_text(yaml.safe_dump(content | changes, sort_keys=False))
    return path


@pytest.mark.parametrize(
    "observations",
    [
        terms(*[1] * 6),
        terms(3, 3, 3, 3, 3, 3),
        terms(1, 2, 3, 1, 2, 4),
        {"use_gym_history": True, **terms(*[3] * 6)},
        {"scale_first": True, **terms(*[2] * 6)},
    ],
    ids=["frame", "history", "histories", "steps-together", "scale-first"],
)
def test_motors_get_what_unitrees_rules_say(tmp_path: Path, observations: dict[str, Any]) -> None:
    path = deploy_yaml(tmp_path / "v0", observations)
    contract, found = imported(path.parent.parent, tmp_path / "out")
    theirs, ours = TheirDeployment(tmp_path / "v0"), controller(tmp_path / "out", contract)
    # The contract's joints are the robot's, which are Unitree's motors.
    assert tuple(joint.name for joint in contract.joints) == NAMES
    assert [joint.stiffness_nm_rad for joint in contract.joints] == GAINS[0]
    assert [joint.damping_nms_rad for joint in contract.joints] == GAINS[1]
    assert contract.timing.control_step_s == 0.04
    assert (contract.training.task, contract.training.checkpoint) == ("v0", "policy.onnx")
    assert contract.training.origin == "from outside (Unitree's deploy.yaml)"
    rng, ranges = np.random.default_rng(0), contract.commands
    for step in range(6):
        state = Motors(rng)
        if step == 0:
            theirs.reset(state)
        commanded = theirs.step(state)
        limits = (ranges.forward_m_s, ranges.left_m_s, ranges.yaw_rate_rad_s)
        command = [np.clip(s, *limit) for s, limit in zip((state.ly, -state.lx, -state.rx), limits, strict=True)]
        (instant,) = instants(rng, 1)
        measured = replace(
            instant,
            root_quat_w=state.quat.astype(np.float64),
            root_ang_vel_b=state.gyro.astype(np.float64),
            joint_pos_rel=state.q - np.array([joint.default_rad for joint in contract.joints]),
            joint_vel=state.dq.astype(np.float64),
            command=np.array(command),
            last_action=ours.last_action,
        )
        np.testing.assert_allclose(ours(measured), commanded["q"], atol=2e-5)
    assert np.ptp(commanded["q"]) > 0.5
    assert not found.about


# mjlab's exporter.


def mjlab_metadata(names: list[str], **more: str) -> dict[str, str]:
    joints = [NAMES[i] for i in SHUFFLED]

    def listed(values: Any) -> str:
        return ",".join(f"{value:.3f}" for value in values)

    return {
        "run_path": "somebody/run",
        "joint_names": ",".join(joints),
        "joint_stiffness": listed(GAINS[0]),
        "joint_damping": listed(GAINS[1]),
        "default_joint_pos": listed(DEFAULT),
        "command_names": "twist",
        "observation_names": ",".join(names),
        "action_scale": listed(ACTION_SCALE),
    } | more


MJLAB = ["base_lin_vel", "base_ang_vel", "projected_gravity", "joint_pos", "joint_vel", "actions", "command"]


def test_joints_move_as_a_network_of_mjlab_says(tmp_path: Path) -> None:
    width = 3 + 3 + 3 + 29 + 2 * 29 + 29 + 3
    metadata = mjlab_metadata(
        MJLAB,
        observation_terms_scale="1.000,0.200;0.500;1.000,1.000,1.000,0.050,1.000,2.000",
        observation_terms_history_length="0.000,0.000,0.000,0.000,2.000,0.000,0.000",
        observation_terms_flatten_history_dim="1.000,1.000,1.000,1.000,1.000,1.000,1.000",
        observation_terms_clip=",".join(["-inf;inf"] * 4 + ["-0.700;0.500"] + ["-inf;inf"] * 2),
    )
    (tmp_path / "policy.onnx").write_bytes(linear(matrix(width), metadata, batch=0))
    contract, found = imported(tmp_path / "policy.onnx", tmp_path / "out")
    assert found.about == ("Its file does not say its commands; up to 1 m/s and 1 rad/s are taken for them.",)
    assert contract.training.origin == "from outside (mjlab)"
    ours, last = controller(tmp_path / "out", contract), np.zeros(JOINTS)
    default, scale = (np.round(values, 3) for values in (DEFAULT, ACTION_SCALE))
    sequence = instants(np.random.default_rng(1), 4)
    for step, measured in enumerate(sequence):
        targets = ours(replace(measured, last_action=ours.last_action))
        before = sequence[max(step - 1, 0)]
        seen = [
            measured.root_lin_vel_b,
            [0.2, 0.5, 1.0] * measured.root_ang_vel_b,
            -measured.up_b,
            measured.joint_pos_rel[SHUFFLED],
            0.05 * np.clip(before.joint_vel[SHUFFLED], -0.7, 0.5),
            0.05 * np.clip(measured.joint_vel[SHUFFLED], -0.7, 0.5),
            last,
            2.0 * measured.command,
        ]
        last = matrix(width) @ np.concatenate(seen)
        expected = by_name(default + scale * last, [NAMES[i] for i in SHUFFLED])
        np.testing.assert_allclose(targets, [expected[name] for name in NAMES], atol=2e-5)


# holosoma's locomotion.


def holosoma_metadata(**changes: Any) -> dict[str, str]:
    metadata = {
        "dof_names": [NAMES[i] for i in SHUFFLED],
        "kp": GAINS[0],
        "kd": GAINS[1],
        "command_ranges": {"lin_vel_x": [-1, 0.9], "lin_vel_y": [-0.8, 0.7], "ang_vel_yaw": [-0.6, 0.5]},
    }
    return {name: json.dumps(value) for name, value in (metadata | changes).items()}


def test_joints_move_as_a_network_of_holosoma_says(tmp_path: Path) -> None:
    """Observations in the order of the alphabet, and a gait of one second that rests where no motion is asked."""
    weights = matrix(100)
    (tmp_path / "ppo.onnx").write_bytes(linear(weights, holosoma_metadata(), ("actor_obs", "action")))
    contract, _ = imported(tmp_path / "ppo.onnx", tmp_path / "out")
    ranges = contract.commands
    assert (ranges.forward_m_s, ranges.left_m_s) == ((-1.0, 0.9), (-0.8, 0.7))
    assert ranges.yaw_rate_rad_s == (-0.6, 0.5)
    ours, last = controller(tmp_path / "out", contract), np.zeros(JOINTS)
    default = np.array([HOLOSOMA_G1.default.get(NAMES[i], 0.0) for i in SHUFFLED])
    slow = [[0.0, 0.0, 0.0], [0.006, 0.006, 0.009]]  # at rest
    quick = [[0.5, 0.0, 0.0], [0.0, 0.0, -0.3], [0.0, 0.011, 0.0]]
    phases = phases_of([0, 1, 1, 1, 0, 0, 1, 1])
    commands = [slow[0], *quick, *slow, quick[1], quick[0]]
    for measured, command, phase in zip(instants(np.random.default_rng(2), 8), commands, phases, strict=True):
        targets = ours(replace(measured, command=np.array(command), last_action=ours.last_action))
        seen = [
            last,
            0.25 * measured.root_ang_vel_b,
            command[2:],
            command[:2],
            np.cos(phase),
            measured.joint_pos_rel[SHUFFLED],
            0.05 * measured.joint_vel[SHUFFLED],
            -measured.up_b,
            np.sin(phase),
        ]
        last = np.clip(weights @ np.concatenate(seen), -100.0, 100.0)
        expected = by_name(default + 0.25 * last, [NAMES[i] for i in SHUFFLED])
        np.testing.assert_allclose(targets, [expected[name] for name in NAMES], atol=2e-5)
    ours.reset()
    assert ours._phase is not None
    np.testing.assert_allclose(ours._phase(np.array([0.5, 0.0, 0.0])), [0.0, np.pi])


def phases_of(moving: list[int]) -> list[NDArray[np.float64]]:
    """Phases by holosoma's rules: they begin at (0, pi) when a motion begins, and are (pi, pi) at rest."""
    phase, rested, result = np.array([0.0, np.pi]), True, []
    for moves in moving:
        phase = np.fmod(phase + 2.0 * np.pi * 0.02 + np.pi, 2.0 * np.pi) - np.pi
        if not moves:
            phase = np.array([np.pi, np.pi])
        elif rested:
            phase = np.array([0.0, np.pi])
        rested = not moves
        result.append(phase)
    return result


def test_an_action_beyond_its_bound_is_cut(tmp_path: Path) -> None:
    (tmp_path / "wild.onnx").write_bytes(linear(1e4 * matrix(100), holosoma_metadata(), ("actor_obs", "action")))
    contract, _ = imported(tmp_path / "wild.onnx", tmp_path / "out")
    ours = controller(tmp_path / "out", contract)
    ours(instants(np.random.default_rng(3), 1)[0])
    assert np.abs(ours.last_action).max() == 100.0
    assert set(np.sign(ours.last_action)) == {-1.0, 1.0}
