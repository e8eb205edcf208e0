"""deploy.yaml under Unitree RL Lab's C++ rules, written down anew here, drives the robot as the contract does.

The rules (deploy/include/isaaclab of unitree_rl_lab): observations in the order of the file; each is computed by the
function of its name, clipped, scaled and kept for `history_length` steps, the oldest first; a reset fills the history
with the present value, and each step adds one. Joint i is motor `joint_ids_map[i]`. A target is scale times action plus
offset. Gains are set motor by motor, in the order of the motors. Sticks are clamped to the ranges of the command.
Everything is in single precision.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
import pytest
import yaml

from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.deploy.controller import Controller, OnnxPolicy
from humoslope.deploy.onboard.unitree_g1 import MOTORS
from humoslope.deploy.quantities import Measured

F = np.float32


class Motors:
    """A LowState: quaternion, gyroscope, and each motor in the order of the SDK; and the remote's sticks."""

    def __init__(self, rng: np.random.Generator) -> None:
        quat = rng.normal(size=4)
        self.quat, self.gyro = (quat / np.linalg.norm(quat)).astype(F), rng.normal(size=3).astype(F)
        self.q, self.dq = rng.normal(size=29).astype(F), rng.normal(size=29).astype(F)
        self.ly, self.lx, self.rx = rng.uniform(-1.0, 1.0, 3).astype(F)


class TheirDeployment:
    """What the C++ program does with a folder."""

    def __init__(self, folder: Path) -> None:
        self.cfg: dict[str, Any] = yaml.safe_load((folder / "params" / "deploy.yaml").read_text())
        self._network = ort.InferenceSession(folder / "exported" / "policy.onnx", providers=["CPUExecutionProvider"])
        self._action = np.zeros(29, dtype=F)
        self._history: dict[str, deque[Any]] = {}

    def reset(self, motors: Motors) -> None:
        self._action[:] = 0.0
        for name, term in self.cfg["observations"].items():
            length = term["history_length"]
            self._history[name] = deque([self._term(name, motors)] * length, maxlen=length)

    def step(self, motors: Motors) -> dict[str, Any]:
        """Commands [29] in the order of the motors."""
        observation = []
        for name in self.cfg["observations"]:
            self._history[name].append(self._term(name, motors))
            observation += list(self._history[name])
        (output,) = self._network.run(["actions"], {"obs": np.concatenate(observation)[None]})
        self._action = output[0]
        action, ids = self.cfg["actions"]["JointPositionAction"], self.cfg["joint_ids_map"]
        targets = self._action * F(action["scale"]) + F(action["offset"])
        q = np.zeros(29, dtype=F)
        q[ids] = targets
        return {"q": q, "kp": F(self.cfg["stiffness"]), "kd": F(self.cfg["damping"])}

    def _term(self, name: str, motors: Motors) -> Any:
        term, ids = self.cfg["observations"][name], self.cfg["joint_ids_map"]
        w, x, y, z = motors.quat
        ranges = self.cfg["commands"]["base_velocity"]["ranges"]
        sticks = {"lin_vel_x": motors.ly, "lin_vel_y": -motors.lx, "ang_vel_z": -motors.rx}
        raw = {
            "base_ang_vel": lambda: motors.gyro,
            # The rotation of (0, 0, -1) by the conjugate.
            "projected_gravity": lambda: F([2 * (w * y - x * z), -2 * (y * z + w * x), 2 * (x * x + y * y) - 1]),
            "velocity_commands": lambda: F([np.clip(stick, *ranges[axis]) for axis, stick in sticks.items()]),
            "joint_pos_rel": lambda: motors.q[ids] - F(self.cfg["default_joint_pos"]),
            "joint_vel_rel": lambda: motors.dq[ids],
            "last_action": lambda: self._action,
        }[name]()
        if term["clip"] is not None:
            raw = np.clip(raw, *term["clip"])
        return np.asarray(raw * F(term["scale"]), dtype=F)


@pytest.fixture(scope="module")
def contract(exported: Path) -> Contract:
    return contracts.read(exported)


def test_the_motors_get_the_same_commands(exported: Path, contract: Contract) -> None:
    theirs, ours = TheirDeployment(exported), Controller(contract, OnnxPolicy(exported, contract.network))
    motor = [MOTORS.index(joint.name) for joint in contract.joints]
    limits = (contract.commands.forward_m_s, contract.commands.left_m_s, contract.commands.yaw_rate_rad_s)
    rng = np.random.default_rng(0)
    for step in range(9):  # longer than the history
        state = Motors(rng)
        if step == 0:
            theirs.reset(state)
        commanded = theirs.step(state)
        default = np.array([joint.default_rad for joint in contract.joints])
        command = [
            np.clip(stick, min(low, 0.0), max(high, 0.0))
            for stick, (low, high) in zip((state.ly, -state.lx, -state.rx), limits, strict=True)
        ]
        measured = Measured(
            root_quat_w=state.quat.astype(np.float64),
            root_ang_vel_b=state.gyro.astype(np.float64),
            joint_pos_rel=state.q[motor] - default,
            joint_vel=state.dq[motor].astype(np.float64),
            command=np.array(command),
            last_action=ours.last_action,
        )
        np.testing.assert_allclose(commanded["q"][motor], ours(measured), atol=1e-4)
        np.testing.assert_allclose(commanded["kp"][motor], [j.stiffness_nm_rad for j in contract.joints], rtol=1e-6)
        np.testing.assert_allclose(commanded["kd"][motor], [j.damping_nms_rad for j in contract.joints], rtol=1e-6)
    assert theirs.cfg["step_dt"] == contract.timing.control_step_s
