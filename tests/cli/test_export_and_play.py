"""`humoslope export` and `humoslope play`: what is written, what is said, and the mistakes."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from humoslope.cli import main
from humoslope.deploy import contract as contracts
from humoslope.deploy import window
from humoslope.learning import checkpoint
from humoslope.seal import SUMS
from robots.unitree_g1 import UNITREE_G1


def test_a_run_is_exported_beside_its_newest_checkpoint_with_its_own_configuration(
    untrained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(untrained, tmp_path / "model_2.pt")
    state = checkpoint.load(untrained)
    state["config"]["env"]["actions"]["scale_factor"] = 0.5
    state["config"]["env"]["command"]["speed"] = (0.2, 0.4)
    checkpoint.save(tmp_path / "model_10.pt", state)
    assert main(["export", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "ONNX 480 -> 29; at most" in printed
    assert "over 600 observations of a walk" in printed
    assert "harness, which still had 100 % of its strength" in printed
    contract = contracts.read(tmp_path / "model_10.export")
    assert contract.joints[3].action_scale_rad == 0.5 * UNITREE_G1.action_scale[3]
    assert contract.commands.forward_m_s == (-0.5, 0.4)  # backward is one of the modes
    assert contract.timing.physics_step_s == 0.005  # of the evaluation, not of the preset

    assert main(["play", str(tmp_path / "model_10.export"), "--headless", "--seconds", "5"]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"It fell after \d\.\d s\. Distance ", printed)
    assert "It was trained at -0.5 to 0.4 m/s." in printed


def test_one_trial_is_reported_and_several_are_counted(exported: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["play", str(exported), "--headless", "--seconds", "2.5", "--grade", "-10"]) == 0
    printed = capsys.readouterr().out
    assert "a ramp of -10 degrees, friction 0.8, 0.5 m/s asked; MuJoCo at 5 ms x 4" in printed
    assert re.search(
        r"No fall in 2\.5 s\. Distance [0-9.]+ m; from 2 s on 0\.\d+ m/s ahead, [0-9.]+ steps per second, both feet "
        r"down \d+% of the time, knees at \d\d°, parts that touch 0\.0% of the time, \d+% of a joint target's variance",
        printed,
    )
    assert "trained at" not in printed
    assert main(["play", str(exported), "--headless", "--seconds", "0.5", "--trials", "2"]) == 0
    printed = capsys.readouterr().out
    assert "Falls 0/2: 0.0 %, 95 % interval 0.0-65.8 %. Means: distance" in printed
    assert "from 2 s on - m/s ahead, - steps per second, both feet down - of the time" in printed


def test_other_commands_begin_on_the_slope_and_conditions_are_options(
    exported: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--lateral", "-0.1", "--speed", "0.4", "--grade", "5", "--timestep-s", "0.01", "--load-kg", "2")
    assert main(["play", str(exported), "--headless", "--seconds", "2.2", "--trials", "2", *options]) == 0
    printed = capsys.readouterr().out
    assert "a ramp of 5 degrees, friction 0.8, 0.4 m/s, 0.1 m/s to the right asked; MuJoCo at 10 ms x 2" in printed
    assert re.search(r"m/s ahead, -?[0-9.]+ m/s to the left, -?[0-9.]+ rad/s, ", printed)


def test_a_turn_outside_of_the_training_is_said(exported: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for rate, warned in (("0.3", False), ("-0.4", True)):
        assert main(["play", str(exported), "--headless", "--seconds", "0.5", "--yaw-rate", rate]) == 0
        printed = capsys.readouterr().out
        assert ("It was trained at 0.3 to 0.8 m/s and to turn at -0.3 to 0.3 rad/s." in printed) == warned


def test_a_robot_that_is_asked_to_stand_is_measured_for_it(
    exported: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["play", str(exported), "--headless", "--seconds", "3", "--speed", "0"]) == 0
    printed = capsys.readouterr().out
    assert "flat ground, friction 0.8, asked to stand; MuJoCo at" in printed
    assert re.search(
        r"No fall in 3 s\. Drift 0\.\d+ m; from 2 s on creep 0\.\d+ m/s, [0-9.]+ steps per second, both feet", printed
    )
    assert "trained at" not in printed
    folder = Path(shutil.copytree(exported, tmp_path / "never stood"))
    (folder / SUMS).unlink()  # the changes are meant
    raw = json.loads((folder / contracts.FILE).read_text())
    raw["commands"]["trained_to_stand"] = False
    for speeds, said in (([0.3, 0.8], "0.3 to 0.8"), ([-0.5, 0.8], "-0.5 to 0.8")):
        raw["commands"]["forward_m_s"] = speeds
        (folder / contracts.FILE).write_text(json.dumps(raw))
        assert main(["play", str(folder), "--headless", "--seconds", "0.5", "--speed", "0", "--trials", "2"]) == 0
        printed = capsys.readouterr().out
        assert f"It was trained at {said} m/s, and not to stand." in printed
        assert re.search(r"Means: drift 0\.\d+ m; from 2 s on creep - m/s, - steps per second, both", printed)


def test_a_window_is_opened_where_one_is_asked_for(
    exported: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(window, "check_display", lambda: None)
    monkeypatch.setattr(window, "live", lambda player, say, gamepad: say("It fell."))
    assert main(["play", str(exported), "--view", "window"]) == 0
    printed = capsys.readouterr().out
    assert window.KEYS in printed
    assert "It fell." in printed


def test_mistakes_are_said_in_one_sentence(
    mistake: Callable[..., str], exported: Path, untrained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "checkpoint" in mistake("export", str(tmp_path / "missing.pt"))
    (tmp_path / "file").write_text("")
    assert "is no folder one can write to" in mistake("export", str(untrained), "--out", str(tmp_path / "file"))

    assert "holds no policy.json; `humoslope export CHECKPOINT` writes one" in mistake("play", str(tmp_path))
    assert "a live walk is one trial; --trials needs --headless" in mistake("play", str(exported), "--trials", "2")
    unasked = ("--lateral", "0.1", "--yaw-rate", "0", "--push-m-s", "0.5")
    for options, said in (
        (unasked, "steered by hand, and nobody pushes it; --lateral, --yaw-rate, --push-m-s: only with --headless"),
        (unasked[4:], "a live walk is steered by hand, and nobody pushes it; --push-m-s: only with --headless"),
    ):
        assert said in mistake("play", str(exported), "--view", "window", *options)
    assert "play: grade is 70; it must be between" in mistake("play", str(exported), "--grade", "70", "--headless")
    monkeypatch.setattr("humoslope.deploy.views.has_display", lambda: False)
    assert "there is no display; serve a page for a browser with --view browser" in mistake("play", str(exported))
