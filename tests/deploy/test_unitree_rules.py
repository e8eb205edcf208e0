"""deploy.yaml under Unitree RL Lab's C++ rules drives the robot as the contract does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.deploy.controller import Controller, OnnxPolicy
from humoslope.deploy.onboard.unitree_g1 import MOTORS
from humoslope.deploy.quantities import Measured
from tests.deploy.unitree_rules import Motors, TheirDeployment


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
