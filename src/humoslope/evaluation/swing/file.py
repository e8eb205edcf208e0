"""Calibration files, which Stage II reads, and the check that one belongs to the checkpoint of Stage I."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

from humoslope.errors import UserError
from humoslope.evaluation.swing.fit import SwingFit
from humoslope.seal import read_json, write_json
from humoslope.slope.swing import SwingCalibration

WHAT = "swing calibration"
FORMAT = 1
"""Raised when a calibration of an older format can no longer be read."""


def calibration_path(checkpoint: Path) -> Path:
    """Path of a checkpoint's calibration, beside the checkpoint."""
    return checkpoint.with_suffix(".swing.json")


def write_calibration(path: Path, found: SwingFit, meta: dict[str, Any]) -> None:
    """Writes a calibration as JSON, in one step.

    The file holds `what` and `format`; `beta0` (rad), `beta1` (rad/rad) and `theta_clip` (rad) with standard errors;
    `rms_residual` (rad); `bins`, each with its `centre` (degrees), `slope` (rad), `flexion` (rad), `count`, `residual`
    (rad) and whether it was `used`; and `meta`.

    Args:
        meta: Provenance; `meta["checkpoint"]` must hold the checkpoint's `path` and `sha256`.
    """
    bins = [
        dataclasses.asdict(b) | {"residual": residual} for b, residual in zip(found.bins, found.residuals, strict=True)
    ]
    whole = {
        "what": WHAT,
        "format": FORMAT,
        **dataclasses.asdict(found.calibration),
        "beta0_error": found.beta0_error,
        "beta1_error": found.beta1_error,
        "rms_residual": found.rms_residual,
        "bins": bins,
        **meta,
    }
    write_json(path, whole)


def load_calibration(path: Path) -> tuple[SwingCalibration, dict[str, Any]]:
    """Coefficients of a calibration file, and all of its contents.

    Raises:
        UserError: If the file is missing, broken, not a calibration, or of another format.
    """
    if not path.is_file():
        raise UserError(f"calibration '{path}' does not exist; `humoslope calibrate CHECKPOINT` makes one.")
    try:
        meta = read_json(path)
    except OSError as error:
        raise UserError(f"calibration '{path}' cannot be read: {error.strerror}.") from None
    except (ValueError, RecursionError):
        raise UserError(
            f"calibration '{path}' is broken or truncated, was changed by hand, or is no JSON at all."
        ) from None
    if not isinstance(meta, dict) or meta.get("what") != WHAT:
        raise UserError(f"'{path}' is not a swing calibration.")
    if meta.get("format") != FORMAT:
        raise UserError(f"calibration '{path}' has format {meta.get('format')}; this version reads format {FORMAT}.")
    beta0, beta1, theta_clip = (_number(path, meta, name) for name in ("beta0", "beta1", "theta_clip"))
    made_from = meta.get("checkpoint")
    if not isinstance(made_from, dict) or not all(isinstance(made_from.get(k), str) for k in ("path", "sha256")):
        raise UserError(f"calibration '{path}' does not say which checkpoint it was made from.")
    try:
        return SwingCalibration(beta0, beta1, theta_clip), meta
    except UserError as error:
        raise UserError(f"calibration '{path}' is broken: {error}") from None


def check_belongs(meta: dict[str, Any], checkpoint: Path, known_as: tuple[str, ...]) -> None:
    """Checks that a calibration was made from `checkpoint`.

    Args:
        meta: From `load_calibration`.
        known_as: SHA-256 of the checkpoint file, hexadecimal, and of files that it was converted from.

    Raises:
        UserError: If it was made from another policy.
    """
    made_from = meta["checkpoint"]
    if made_from["sha256"] not in known_as:
        raise UserError(
            f"the calibration was made from checkpoint '{made_from['path']}' (sha256 {made_from['sha256'][:12]}), not "
            f"from '{checkpoint}' ({known_as[0][:12]}); calibrate that one with `humoslope calibrate {checkpoint}`."
        )


def _number(path: Path, meta: dict[str, Any], name: str) -> float:
    value = meta.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UserError(f"calibration '{path}' is broken: {name} is {value!r}; it must be a finite number.")
    return float(value)
