"""Start of a new run: for a later stage, the checkpoint of the earlier one and its swing calibration."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from humoslope import shipped
from humoslope.errors import UserError
from humoslope.evaluation.swing.file import calibration_path, check_belongs, load_calibration
from humoslope.learning import checkpoint
from humoslope.learning.policy import Provenance, find_checkpoint, read_provenance
from humoslope.learning.run_folder import LOGS, runs_of
from humoslope.registry import WarmStartCfg

PRIOR = "prior"
"""In place of a calibration's path: the values that the task's configuration has."""


@dataclass(frozen=True)
class Origin:
    """Start of a new run.

    Attributes:
        parent: The checkpoint whose actor it takes; None to start from nothing.
        options: Options that set the calibrated reward.
        calibration: A sentence on where their values come from.
    """

    parent: Provenance | None = None
    options: tuple[str, ...] = ()
    calibration: str = ""


def find_origin(start: WarmStartCfg | None, init: str, calibration: str) -> Origin:
    """Finds the start of a new run of a task.

    Args:
        start: The task that it goes on from; None if it needs no other.
        init: A checkpoint, or a run folder for its newest one; "" for the newest of the newest run under logs/, else
            the shipped one.
        calibration: A file; "" for the one beside the checkpoint; or `PRIOR`.

    Raises:
        UserError: If something is missing, or does not belong together.
    """
    if start is None:
        if calibration:
            raise UserError("--calibration: this task has no reward that a swing calibration sets.")
        return Origin(read_provenance(find_checkpoint(Path(init))) if init else None)
    path = find_checkpoint(Path(init)) if init else _newest(start)
    earlier = read_provenance(path, start.task)
    if not start.calibrated:
        return Origin(earlier)
    if calibration == PRIOR:
        return Origin(earlier, calibration="Swing calibration: the prior, as configured.")
    file = shipped.found(Path(calibration) if calibration else calibration_path(path))
    if not calibration and not file.is_file():
        raise UserError(
            f"there is no swing calibration '{file}'; make it with `make calibrate CHECKPOINT={path}`, name another "
            f"with --calibration, or take the documented prior with --calibration {PRIOR}."
        )
    swing, measured = load_calibration(file)
    check_belongs(measured, path, (earlier.sha256, *earlier.formerly))
    prefix = f"--env.rewards.{start.calibrated.replace('_', '-')}.params."
    options = [word for name, value in vars(swing).items() for word in (prefix + name.replace("_", "-"), repr(value))]
    told = ", ".join(f"{name} {value:.4g}" for name, value in vars(swing).items())
    return Origin(earlier, tuple(options), f"Swing calibration {file}: {told}.")


def _newest(start: WarmStartCfg) -> Path:
    runs = runs_of(start.task)
    walker = shipped.root() / start.shipped
    if runs:
        return checkpoint.latest(runs[-1])
    if walker.is_file():
        return walker
    raise UserError(
        f"this task starts from a checkpoint of {start.task}, and there is none under {LOGS}; "
        "train that first, or name a checkpoint with --init."
    )
