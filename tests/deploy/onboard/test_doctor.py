"""Each fault of the simulated robot, and each mistake of a program, is named; a sound walk is not blamed."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from humoslope.cli import main
from humoslope.deploy.contract import Contract
from humoslope.deploy.controller import OnnxPolicy
from humoslope.deploy.doctor import network
from humoslope.deploy.doctor.diagnose import diagnose
from humoslope.deploy.doctor.imu import TILTED_DEG
from humoslope.deploy.doctor.network import mistakes
from humoslope.deploy.doctor.walk import Finding, read_walk
from humoslope.deploy.onboard import states
from humoslope.deploy.onboard.guards import Limits
from humoslope.deploy.onboard.log import to_rollout
from humoslope.deploy.onboard.simulated import Faults
from humoslope.errors import UserError
from humoslope.replay.rollout import load_rollout
from tests.deploy.onboard.conftest import SHORT

ROPE = "0.15:start 0.4:start 0.4:lower 0.8:A"
"""The rope stays on, and the robot marks time: a robot with wrong encoders does not walk."""


@pytest.fixture(scope="module")
def recorded(
    stage: Callable[..., Any],
    exported: Path,
    contract: Contract,
    tmp_path_factory: pytest.TempPathFactory,
) -> Callable[..., Path]:
    """recorded(faults, script=..., seconds=...): the rollout of a walk."""

    def make(faults: Faults, script: str = SHORT, seconds: float = 5.0, **more: Any) -> Path:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(states, "MOVE_S", 0.3)
            walk = stage(script, faults=faults, limits=Limits(start_pose_rad=3.0), hold_heading=True, **more)
            walk.run(seconds)
        rollout, arrays = to_rollout(exported, contract, walk.session.ticks, "test")
        path = tmp_path_factory.mktemp("doctor") / "walk.npz"
        rollout.save(path, **arrays)
        return path

    return make


@pytest.fixture(scope="module")
def examine(exported: Path, contract: Contract) -> Callable[[Path], list[Finding]]:
    policy = OnnxPolicy(exported, contract.network)
    return lambda path: diagnose(path, exported, contract, policy)


@pytest.fixture(scope="module")
def sound(recorded: Callable[..., Path]) -> Path:
    return recorded(Faults(), grade=10.0, seconds=5.0)


def first(findings: list[Finding]) -> str:
    return next(f"{finding.check}: {finding.words}" for finding in findings if finding.wrong)


def test_a_sound_robot_is_not_blamed_on_a_slope_either(sound: Path, examine: Callable[[Path], list[Finding]]) -> None:
    assert [finding for finding in examine(sound) if finding.wrong] == []


@pytest.mark.parametrize(
    ("faults", "script", "said"),
    [
        (
            Faults(swap=("left_hip_pitch_joint", "right_hip_pitch_joint")), ROPE,
            "encoders: exchanged: left_hip_pitch_joint shows right_hip_pitch_joint, right_hip_pitch_joint shows",
        ),
        (Faults(mirrored=True), ROPE, "encoders: left and right are exchanged ("),
        (Faults(flip="left_ankle_pitch_joint"), ROPE, "encoders: counting backward: left_ankle_pitch_joint"),
        (Faults(velocity_scale=0.5), SHORT, "joint velocities: are 0.49 times the rates of the positions"),
        (Faults(gyro_sign=-1.0), ROPE, "gyroscope: has the opposite sign"),
        (Faults(imu_delay_s=0.03), SHORT, "age of the IMU: it is 3"),
        (Faults(delay_s=0.03), ROPE, "delay: from a target to the message that shows its torque it takes 20 to 40 ms"),
        (Faults(command_delay_s=0.03), ROPE, "delay: from a target to the message that shows its torque it takes 20"),
        (Faults(stiffness_scale=0.7), SHORT, "gains: stiffness is 0.70 and damping 1.00 times the contract's"),
        (Faults(damping_scale=2.0), SHORT, "gains: stiffness is 1.00 and damping 2.00 times the contract's"),
    ],
)  # fmt: skip
def test_the_fault_of_a_robot_is_named(
    recorded: Callable[..., Path], examine: Callable[[Path], list[Finding]], faults: Faults, script: str, said: str
) -> None:
    findings = examine(recorded(faults, script, 3.0 if script == ROPE else 6.0))
    assert first(findings).startswith(said)
    assert not findings[0].wrong  # the program did what the contract says with what it read


def test_a_tilted_imu_is_named_with_its_axis(
    recorded: Callable[..., Path], examine: Callable[[Path], list[Finding]]
) -> None:
    findings = examine(recorded(Faults(imu_tilt_deg=(4.0, 0.0)), SHORT, 6.0))
    assert not findings[0].wrong
    found = re.match(r"mounting of the IMU: turned by .* \((\S+) about x, (\S+) about y\)$", first(findings))
    assert found is not None
    assert [float(degrees) for degrees in found.groups()] == pytest.approx([4.0, 0.0], abs=TILTED_DEG)


@pytest.mark.parametrize(
    "words",
    [
        "gravity_direction has the opposite sign",
        "joint_velocity is scaled by 20",
        "velocity_command is missing (zero)",
        "the history is newest first",
        "the history is laid out frame by frame",
        "the IMU is 1 control steps late",
        "left and right joints are exchanged, in the measurements alone",
        "joints are in alphabetical order, in the measurements alone",
        "quaternions are x, y, z, w",
    ],
)
def test_the_mistake_of_a_program_is_named(
    sound: Path,
    exported: Path,
    contract: Contract,
    examine: Callable[[Path], list[Finding]],
    tmp_path: Path,
    words: str,
) -> None:
    """Of one that made its observations so, on the measurements of a sound walk."""
    path = tmp_path / "walk.npz"
    with np.load(sound) as archive:
        arrays = dict(archive)
    arrays["action"] = acted(sound, exported, contract, words, arrays["action"])
    np.savez(path, **arrays)
    (finding,) = [finding for finding in examine(path) if finding.check == "network"]
    assert finding.wrong
    assert finding.words.startswith(f"{words}: then the actions differ by ")


def acted(sound: Path, exported: Path, contract: Contract, words: str, action: Any) -> Any:
    """The actions of a program with a mistake that sees the measurements of a walk, and its own last actions."""
    (mistake,) = [mistake for mistake in mistakes(contract) if mistake.words == words]
    walk, policy = read_walk(sound, exported, contract), OnnxPolicy(exported, contract.network)
    step = contract.observations[0].history + network.LATEST  # the first one that is computed

    def keep(observations: Any) -> Any:
        nonlocal step
        walk.action[step] = policy(observations)
        step += 1
        return walk.action[step - 1]

    network.difference(walk, contract, keep, mistake, len(walk))  # type: ignore[arg-type]
    changed = action.copy()
    changed[-len(walk) :] = walk.action
    return changed


def test_a_log_of_another_contract_is_refused(
    sound: Path, spoil: Callable[..., Path], contract: Contract, capsys: pytest.CaptureFixture[str]
) -> None:
    def heavier(raw: Any) -> None:
        raw["joints"][0]["stiffness_nm_rad"] = 1.0

    assert main(["doctor", str(spoil(heavier)), str(sound)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "was recorded with another contract than the one in" in said


def test_a_recording_that_is_younger_than_what_the_policy_saw_is_refused(
    sound: Path, exported: Path, contract: Contract, tmp_path: Path
) -> None:
    """`humoslope record` keeps the robot's state of one physics step before, whatever the policy saw."""
    rollout, path = load_rollout(sound), tmp_path / "walk.npz"
    replace(rollout, header=rollout.header | {"protocol": {}}).save(path)
    read_walk(path, exported, contract)  # one that saw the same
    older = replace(contract, timing=replace(contract.timing, observation_age_s=0.01))
    with pytest.raises(UserError, match="shows the robot 5 ms before each step, and the policy saw it 10 ms before"):
        read_walk(path, exported, older)
    assert len(read_walk(sound, exported, older))  # of `humoslope deploy`, which keeps what the policy saw


def test_the_doctor_says_what_to_look_at_first(sound: Path, exported: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", str(exported), str(sound)]) == 0
    assert "Nothing is out." in capsys.readouterr().out


def test_a_walk_that_is_too_short_is_refused(
    recorded: Callable[..., Path], examine: Callable[[Path], list[Finding]]
) -> None:
    with pytest.raises(UserError, match="holds [0-9]+ steps of walking; a diagnosis needs 50"):
        examine(recorded(Faults(), seconds=1.0))
