"""Over Unitree's own DDS, on the loopback interface; and what is said where it is not installed.

Messages are waited for, not timed: a slow machine makes these tests slow, and not wrong.
"""

from __future__ import annotations

import ast
import gc
import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from humoslope.cli import deploy, main
from humoslope.deploy.contract import Contract
from humoslope.deploy.onboard.messages import Command, Reading, Remote
from humoslope.deploy.onboard.pace import pace_on
from humoslope.deploy.onboard.simulated import SimulatedRobot
from humoslope.deploy.onboard.unitree_link import UnitreeLink, UnitreeRobot, open_interface
from humoslope.errors import UserError
from humoslope.replay.rollout import load_rollout
from tests import processes
from tests.deploy.onboard.conftest import SCRIPT
from tests.processes import Running

needs_sdk = pytest.mark.skipif(find_spec("unitree_interface") is None, reason="needs the extra [robot]")
LONG_S = 120.0
"""Longest time to wait for anything, s."""


def test_a_missing_sdk_is_one_sentence_with_the_command(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "unitree_interface", None)
    with pytest.raises(UserError) as error:
        open_interface("lo", "")
    assert "pip install 'humoslope[robot]'" in str(error.value)
    assert str(error.value).count(".") <= 2


def test_an_interface_that_is_not_there_is_said() -> None:
    with pytest.raises(UserError, match=r"there is no network interface 'eth9'; there are: .*lo"):
        open_interface("eth9", "")


def test_a_simulated_robot_never_speaks_on_a_network(contract: Contract) -> None:
    with pytest.raises(UserError, match="a simulated robot speaks on the loopback interface 'lo' only, not on 'eth0'"):
        UnitreeRobot(contract, "eth0", "")
    with pytest.raises(UserError, match="--slower is for a simulated robot on 'lo'; a real one does not wait"):
        pace_on("eth0", 2.0)
    with pytest.raises(UserError, match="--slower 0.5 must be between 1 and 100"):
        pace_on("lo", 0.5)


class Readers:
    """The package's interface with nothing to read, which says when it is destroyed."""

    def __init__(self, destroyed: list[str]) -> None:
        self.destroyed = destroyed

    def read_low_state(self) -> SimpleNamespace:
        return SimpleNamespace(motor=SimpleNamespace(q=[], dq=[]), imu=SimpleNamespace(omega=[], quat=[0.0] * 4))

    def read_wireless_controller(self) -> None: ...

    def __del__(self) -> None:
        self.destroyed.append("now")


def test_a_closed_link_does_not_destroy_readers_that_a_message_may_just_reach(
    contract: Contract, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The SDK would abort the process."""
    destroyed: list[str] = []
    creates = SimpleNamespace(create_g1=lambda *_, **__: Readers(destroyed))
    monkeypatch.setitem(sys.modules, "unitree_interface", SimpleNamespace(UnitreeInterface=creates))  # type: ignore[arg-type]
    link = UnitreeLink(contract, "lo")
    link.close()
    del link
    gc.collect()
    assert destroyed == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["deploy", "EXPORT", "--interface", "eth9"], "there is no network interface 'eth9'"),
        (["deploy", "EXPORT", "--interface", "lo", "--speed", "9"], "--speed 9 must be between 0 and 0.8 m/s"),
        (["deploy", "EXPORT", "--interface", "lo", "--limit.slew-rad-s", "0"], "slew_rad_s is 0; it must be positive"),
        (["deploy", "nowhere", "--interface", "lo"], "export folder 'nowhere' does not exist"),
        (["robot", "EXPORT", "--script", "start"], "script: 'start' must be like 1:start"),
        (["robot", "EXPORT", "--grade", "80"], "robot: grade is 80; it must be between -60 and 60 (too high)"),
        (["robot", "EXPORT", "--interface", "eth0"], "the loopback interface 'lo' only"),
        (["robot", "EXPORT", "--fault.flip", "left_nee_joint"], "joint 'left_nee_joint' does not exist; did you mean"),
    ],
)
def test_bad_input_gets_one_sentence(
    exported: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    assert main([str(exported) if word == "EXPORT" else word for word in arguments]) == 2
    found = capsys.readouterr().err
    assert said in found
    assert found.count("\n") == 1


@pytest.mark.parametrize(
    ("reason", "code"),
    [
        ("stop was asked for", 0),
        ("the program was asked to end", 0),
        ("2.5 s are over", 0),
        ("the robot leans by 60 degrees, more than 57", 2),
    ],
)
def test_an_end_that_nobody_asked_for_is_a_failure_also_within_a_given_time(
    exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reason: str, code: int
) -> None:
    for name in ("load_sdk", "sdk_on_stderr"):
        monkeypatch.setattr(deploy, name, lambda *_: None)
    monkeypatch.setattr(deploy, "UnitreeLink", lambda *_: SimpleNamespace(close=lambda: None))
    monkeypatch.setattr(deploy, "drive", lambda session, *_: session.stop(reason))
    monkeypatch.chdir(tmp_path)
    assert main(["deploy", str(exported), "--interface", "lo", "--dry-run", "--seconds", "2.5"]) == code


def test_an_export_with_another_network_is_refused(spoil: Callable[..., Path]) -> None:
    folder = spoil()
    network = folder / "exported" / "policy.onnx"
    network.write_bytes(network.read_bytes() + b" ")
    assert main(["deploy", str(folder), "--interface", "lo"]) == 2


# With the SDK.


@pytest.fixture
def tag() -> str:
    """Participants with other tags, in tests beside this one, are not heard."""
    return f"test-{uuid.uuid4().hex[:12]}"


@pytest.fixture
def start(exported: Path, tag: str) -> Iterator[Callable[..., Running]]:
    """start("robot", "--grade", "20"): the verb as a process on the loopback interface, ended after the test."""
    running: list[Running] = []

    def make(verb: str, *arguments: str, prepare: Callable[[], object] | None = None) -> Running:
        given = (verb, str(exported), "--interface", "lo", "--tag", tag, *arguments)
        running.append(processes.start(*given, prepare=prepare))
        return running[-1]

    yield make
    for process in running:
        if process.poll() is None:
            process.send(signal.SIGTERM)
        process.wait(LONG_S)


WALKS, HANGS = ("--slower", "4"), ("--slower", "2")
"""A robot that walks feels how late its commands are; one that hangs from the gantry does not."""
TOLERANT = {
    WALKS: ("--limit.silent-s", "2", "--limit.missed-ticks", "50"),
    HANGS: ("--limit.silent-s", "4", "--limit.missed-ticks", "100"),
}
"""For machines that are busy: the times are tested without processes."""


@needs_sdk
def test_messages_arrive_in_both_directions_as_they_were_sent(exported: Path, contract: Contract, tag: str) -> None:
    code = f"""
import sys, time
sys.path[:0] = {sys.path!r}
from pathlib import Path
import numpy as np
from humoslope.deploy import contract as contracts
from humoslope.deploy.onboard.messages import Command
from humoslope.deploy.onboard.unitree_link import UnitreeLink
contract = contracts.read(Path(sys.argv[1]))
link = UnitreeLink(contract, "lo", sys.argv[2])
while (reading := link.read()) is None or "A" not in reading.remote.buttons:
    time.sleep(0.01)
assert not link.foreign()
rows = np.arange(29.0)
link.write(Command(0.01 * rows, rows, 0.5 * rows))
sys.stderr.write(repr([reading.quat_w.tolist(), reading.joint_pos.tolist(), reading.temperature.tolist(),
    reading.mode_machine, reading.remote.forward, reading.remote.turn, sorted(reading.remote.buttons)]) + "\\n")
while True:
    time.sleep(0.1)
"""
    robot = UnitreeRobot(contract, "lo", tag)
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(exported), tag], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    try:
        sent = Reading(
            count=1,
            quat_w=np.array([0.5, 0.5, -0.5, 0.5]),
            ang_vel_b=np.array([0.1, 0.2, 0.3]),
            joint_pos=0.01 * np.arange(29.0),
            joint_vel=np.zeros(29),
            torque=np.zeros(29),
            temperature=30.0 + np.arange(29.0),
            errors=np.zeros(29),
            mode_machine=5,
            remote=Remote(),
        )
        end, heard = time.monotonic() + LONG_S, None
        while heard is None and time.monotonic() < end:
            robot.say(sent)
            robot.press(Remote(frozenset({"A"}), 0.5, 0.0, -0.25))
            heard = robot.hear()
            time.sleep(0.005)
        assert heard is not None
        rows = np.arange(29.0)
        np.testing.assert_allclose(heard.target, 0.01 * rows, rtol=1e-6)
        np.testing.assert_allclose(heard.stiffness, rows, rtol=1e-6)
        np.testing.assert_allclose(heard.damping, 0.5 * rows, rtol=1e-6)
    finally:
        process.kill()
        _, said = process.communicate()
    line = next(line for line in said.splitlines() if line.startswith("[["))
    quat, joints, temperature, build, forward, turn, buttons = ast.literal_eval(line)
    np.testing.assert_allclose(quat, sent.quat_w)
    np.testing.assert_allclose(joints, sent.joint_pos, rtol=1e-6)
    np.testing.assert_allclose(temperature, sent.temperature)
    assert (build, forward, turn, buttons) == (5, 0.5, -0.25, ["A"])


@needs_sdk
def test_two_processes_start_walk_and_stop(start: Callable[..., Running], tmp_path: Path) -> None:
    out, walk = tmp_path / "robot.json", tmp_path / "walk.npz"
    robot = start("robot", *WALKS, "--script", f"{SCRIPT} 8:select", "--out", str(out))
    robot.wait_for("simulated", LONG_S)
    deploy = start("deploy", *WALKS, "--out", str(walk), "--hold-heading", *TOLERANT[WALKS])
    for word in ("zero torque", "move", "hold", "walk", "damping: stop was asked for", "wrote"):
        deploy.wait_for(word, LONG_S)
    assert deploy.wait(LONG_S).returncode == 0
    robot.wait_for("motors damped", LONG_S)
    robot.send(signal.SIGTERM)
    robot.wait(LONG_S)
    happened = json.loads(out.read_text())
    assert [event["motors"] for event in happened["events"]] == ["limp", "held", "damped"]
    assert happened["events"][-1]["x"] > 0.5
    rollout = load_rollout(walk)
    assert rollout.columns.root_pos_w[-1, 0] > 0.5


NEVER_S = 1000.0


def silent_once_held() -> None:
    """Lets a robot that would fall silent only at `NEVER_S` do so half a second after its motors are first held."""
    own = SimulatedRobot.receive

    def receive(self: SimulatedRobot, command: Command) -> None:
        own(self, command)
        if self.held and self.faults.silent_at_s == NEVER_S:
            self.faults = replace(self.faults, silent_at_s=self.time + 0.5)

    SimulatedRobot.receive = receive  # type: ignore[method-assign]


@needs_sdk
@pytest.mark.parametrize("ending", ["terminated", "killed", "guardian", "silent"])
def test_whatever_ends_the_program_the_robot_is_damped(
    start: Callable[..., Running], tmp_path: Path, ending: str
) -> None:
    fault = ("--fault.silent-at-s", str(NEVER_S)) if ending == "silent" else ()
    prepare = silent_once_held if ending == "silent" else None
    robot = start("robot", *HANGS, "--script", "0.4:start", *fault, prepare=prepare)
    robot.wait_for("simulated", LONG_S)
    deploy = start("deploy", *HANGS, "--out", str(tmp_path / "walk.npz"), *TOLERANT[HANGS])
    deploy.wait_for("move", LONG_S)
    robot.wait_for("motors held", LONG_S)
    if ending == "terminated":
        a_second_program_does_not_join_in(start, tmp_path / "second.npz")
        deploy.send(signal.SIGTERM)
    elif ending == "killed":
        deploy.send(signal.SIGKILL)
    elif ending == "guardian":
        children = Path(f"/proc/{deploy.pid}/task/{deploy.pid}/children").read_text().split()
        os.kill(int(children[0]), signal.SIGKILL)
    robot.wait_for("motors damped", LONG_S)
    code = deploy.wait(LONG_S).returncode
    assert code == {"terminated": 0, "killed": -9, "guardian": 2, "silent": 2}[ending]


def a_second_program_does_not_join_in(start: Callable[..., Running], out: Path) -> None:
    second = start("deploy", *HANGS, "--out", str(out), *TOLERANT[HANGS])
    second.wait_for("not yet: somebody else commands the motors; put the robot into debug mode", LONG_S)
    second.send(signal.SIGTERM)
    assert second.wait(LONG_S).returncode == 0
    assert not out.exists()
