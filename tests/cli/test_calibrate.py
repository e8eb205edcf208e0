"""`humoslope calibrate`: the file, the picture, and the mistakes."""

from __future__ import annotations

import hashlib
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from humoslope.cli import main
from humoslope.evaluation.swing.file import check_belongs, load_calibration

WALKER = Path(__file__).parents[2] / "experiments/checkpoints/stage1.pt"
QUICK = ("--grades", "-10", "0", "10", "15", "20", "--starts", "1", "--seconds", "6.5", "--least-samples", "10")


def test_a_walker_is_calibrated_and_file_picture_and_screen_agree(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "g1.json"
    assert main(["calibrate", str(WALKER), *QUICK, "--out", str(out)]) == 0
    calibration, meta = load_calibration(out)
    assert out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    check_belongs(meta, WALKER, hashlib.sha256(WALKER.read_bytes()).hexdigest())
    assert 0.2 < calibration.beta0 < 1.0
    assert calibration.theta_clip == pytest.approx(math.radians(30.0))
    used = [b for b in meta["bins"] if b["used"]]
    assert {b["centre"] for b in used} == {-10.0, 0.0, 10.0, 15.0, 20.0}
    for b in used:
        assert b["slope"] == pytest.approx(math.radians(b["centre"]), abs=math.radians(1.0))
        expected = calibration.beta0 + calibration.beta1 * max(b["slope"], 0.0)
        assert b["flexion"] - expected == pytest.approx(b["residual"], abs=1e-9)
    assert meta["checkpoint"]["task"] == "HumoSlope-Stage1-Unitree-G1"
    assert meta["physics"]["cone"] == "elliptic"
    assert meta["fit"]["percentile"] == 90.0
    assert meta["command_line"].startswith("humoslope calibrate ")
    assert meta["samples"] == sum(b["count"] for b in meta["bins"])

    printed = capsys.readouterr().out
    assert f"beta0 {calibration.beta0:.4f}" in printed
    assert "prior for comparison: beta0 0.45 rad" in printed
    assert f"wrote {out}" in printed


def test_a_robot_that_cannot_walk_is_refused_with_the_prior_offered_and_nothing_is_written(
    untrained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Path(shutil.copy(untrained, tmp_path))
    assert main(["calibrate", str(path), "--starts", "1", "--seconds", "1", "--grades", "0", "10"]) == 2
    captured = capsys.readouterr()
    assert "train Stage II with --calibration prior" in captured.err
    assert captured.err.count("\n") == 1
    assert "left out: fewer than 500 samples" in captured.out
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--hip", ".*hip.*"), "must match one left and one right joint of unitree_g1"),
        (("--percentile", "100"), "percentile is 100; it must be between 50 and 100, 100 excluded"),
        (("--grades", "90"), "grades is (90); of each, it must be between -60 and 60"),
        (("--swing-force", "0"), "swing_force is 0"),
        (("--out", "."), "is a folder"),
        (("--out", "a.png"), "is where the picture goes; name the JSON file, such as 'a.swing.json'"),
    ],
)
def test_an_impossible_option_is_said_in_one_sentence(
    mistake: Callable[..., str], untrained: Path, options: tuple[str, str], said: str
) -> None:
    assert said in mistake("calibrate", str(untrained), *options)


def test_what_is_no_checkpoint_is_said_in_one_sentence(mistake: Callable[..., str], tmp_path: Path) -> None:
    assert "does not exist" in mistake("calibrate", str(tmp_path / "missing.pt"))
    (tmp_path / "run").mkdir()
    assert "holds no checkpoint" in mistake("calibrate", str(tmp_path / "run"))
