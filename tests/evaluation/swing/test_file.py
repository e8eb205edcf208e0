"""A calibration comes back as it was written, or it is said why not."""

from __future__ import annotations

import json
import math
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.evaluation.swing.file import (
    FORMAT,
    calibration_path,
    check_belongs,
    load_calibration,
    write_calibration,
)
from humoslope.evaluation.swing.fit import Bin, SwingFit
from humoslope.seal import read_json
from humoslope.slope.swing import SwingCalibration

SHA = "c4edf1c2d3e8" + 52 * "0"
META = {"checkpoint": {"path": "runs/model_7.pt", "sha256": SHA}}


def found(beta0: float = 0.5, beta1: float = 0.8, theta_clip: float = 0.5) -> SwingFit:
    bins = (Bin(-2.5, 0, -0.04, None, False), Bin(0.0, 700, 0.001, 0.51, True))
    return SwingFit(SwingCalibration(beta0, beta1, theta_clip), 0.01, 0.02, bins, (None, 0.01), 0.01)


@given(beta0=st.floats(-5.0, 5.0), beta1=st.floats(-5.0, 5.0), theta_clip=st.floats(0.01, 1.5))
def test_coefficients_come_back_to_the_last_digit(beta0: float, beta1: float, theta_clip: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.swing.json"
        write_calibration(path, found(beta0, beta1, theta_clip), META)
        calibration, meta = load_calibration(path)
    assert calibration == SwingCalibration(beta0, beta1, theta_clip)
    assert meta["checkpoint"] == META["checkpoint"]


def test_the_file_holds_every_bin_with_its_residual(tmp_path: Path) -> None:
    write_calibration(tmp_path / "a.json", found(), META)
    _, meta = load_calibration(tmp_path / "a.json")
    assert meta["format"] == FORMAT
    assert meta["rms_residual"] == 0.01
    assert meta["bins"] == [
        {"centre": -2.5, "count": 0, "slope": -0.04, "flexion": None, "used": False, "residual": None},
        {"centre": 0.0, "count": 700, "slope": 0.001, "flexion": 0.51, "used": True, "residual": 0.01},
    ]


def test_it_lies_beside_its_checkpoint() -> None:
    assert calibration_path(Path("runs/model_7.pt")) == Path("runs/model_7.swing.json")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"what": "ramps"}, "is not a swing calibration"),
        ({"format": 99}, f"has format 99; this version reads format {FORMAT}"),
        ({"beta0": None}, "beta0 is None; it must be a finite number"),
        ({"beta1": "0.8"}, "beta1 is '0.8'"),
        ({"beta1": True}, "beta1 is True"),
        ({"beta0": math.nan}, "beta0 is nan"),
        ({"theta_clip": 30.0}, "theta_clip is 30 rad; it must be between 0 and pi/2"),
        ({"checkpoint": None}, "does not say which checkpoint"),
        ({"checkpoint": {"path": "a.pt"}}, "does not say which checkpoint"),
    ],
)
def test_what_is_no_calibration_is_refused_in_one_sentence(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    path = tmp_path / "a.json"
    write_calibration(path, found(), META)
    path.write_text(json.dumps(read_json(path) | change))  # without its seal, as files of earlier versions
    with pytest.raises(UserError) as caught:
        load_calibration(path)
    assert said in str(caught.value)
    assert "a.json" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe\x00", b'{"what": "swing cal'])
def test_a_broken_file_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(UserError, match="is broken or truncated"):
        load_calibration(tmp_path / "a.json")


def test_a_list_is_no_calibration_and_a_missing_file_says_how_to_make_one(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("[1, 2]")
    with pytest.raises(UserError, match="is not a swing calibration"):
        load_calibration(tmp_path / "a.json")
    with pytest.raises(UserError, match="does not exist; `humoslope calibrate CHECKPOINT` makes one"):
        load_calibration(tmp_path / "b.json")


def test_a_calibration_belongs_to_the_policy_it_was_made_from_wherever_that_lies_now() -> None:
    check_belongs(META, Path("elsewhere/best.pt"), (SHA,))
    check_belongs(META, Path("elsewhere/converted.pt"), (64 * "1", SHA))
    with pytest.raises(UserError) as caught:
        check_belongs(META, Path("runs/model_8.pt"), (64 * "1",))
    assert "made from checkpoint 'runs/model_7.pt' (sha256 c4edf1c2d3e8)" in str(caught.value)
    assert "not from 'runs/model_8.pt' (111111111111)" in str(caught.value)
