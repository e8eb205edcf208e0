"""Finished trials on disk, from which an interrupted evaluation continues."""

from __future__ import annotations

import hashlib
import json
import sys
import zipfile
import zlib
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray

from humoslope.env import EnvCfg
from humoslope.evaluation.track.arrays import from_arrays, map_arrays, to_arrays, where_arrays
from humoslope.evaluation.track.metrics import METRICS_VERSION, RECORDED
from humoslope.evaluation.track.protocol import HeldOutProtocol
from humoslope.evaluation.track.recorder import TrackTrials
from humoslope.evaluation.track.trials import HeldOutTrials, TrialScheduler
from humoslope.provenance import plain
from humoslope.seal import read_arrays, write_arrays


class SavedTrials(NamedTuple):
    """Contents of a file.

    Attributes:
        trials: All trials, also those that are not finished yet.
        wall_clock_s: Time that they took in all calls, s.
        code: Commits that they were run with.
    """

    trials: HeldOutTrials
    wall_clock_s: float
    code: tuple[str, ...]


def trial_fingerprint(cfg: EnvCfg, scheduler: TrialScheduler, sha256: str) -> str:
    """Hash of everything that decides the record of a trial: protocol, ground, environment, definitions of the metrics,
    machine and checkpoint.

    The number of trials is not in it, so that an evaluation with a few of them is the beginning of a full one.

    Args:
        sha256: Hash of the checkpoint.
    """
    protocol = asdict(scheduler.protocol)
    del protocol["trials"]
    # The contents of the files that describe the robot count, not their paths; meshes are only for display.
    robot = cfg.scene.robot
    described = plain(robot) | {"urdf": hashlib.sha256(robot.urdf.read_bytes()).hexdigest(), "meshes": None}
    whole = {
        "protocol": protocol,
        "parallel_trials": scheduler.parallel_trials,
        "ground": hashlib.sha256(cfg.scene.terrain.build().heights.tobytes()).hexdigest(),
        "segments": plain(scheduler.course.segments),
        "environment": {name: plain(value) for name, value in vars(cfg).items() if name != "scene"},
        "robot": described,
        # The number of threads is left out because trials run on one.
        "machine": [torch.cuda.is_available(), torch.__version__, mujoco.__version__],
        "metrics": [METRICS_VERSION, *(metric.name for metric in RECORDED)],
        "checkpoint": sha256,
    }
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()


def save(path: Path, saved: SavedTrials, fingerprint: str, protocol: HeldOutProtocol) -> None:
    """Writes the trials of a protocol with their fingerprint in one step.

    Trials in the file beyond those of the protocol are kept if they have the same fingerprint.
    """
    trials, before = saved.trials, _read(path, fingerprint)
    if before is not None and len(before.trials) > len(trials):
        larger = replace(protocol, trials=len(before.trials) // protocol.num_cells)
        padded = map_arrays(partial(_resize, protocol=larger), trials)
        steps = next((values.shape[1] for values in trials.moments.values()), 0)
        old = before.trials.with_moments(steps)
        trials = map_arrays(partial(where_arrays, padded.finished), padded.with_moments(steps), old)
    about = {"fingerprint": fingerprint, "wall_clock_s": saved.wall_clock_s, "code": saved.code}
    arrays: dict[str, Any] = {name: np.array(value) for name, value in about.items()} | to_arrays(trials)
    write_arrays(path, arrays)


def load(path: Path, fingerprint: str, protocol: HeldOutProtocol) -> SavedTrials | None:
    """The trials of this protocol that are saved at `path` under this fingerprint.

    None if there is no such file, or it has another fingerprint.
    """
    found = _read(path, fingerprint)
    if found is None:
        return None
    return found._replace(trials=map_arrays(partial(_resize, protocol=protocol), found.trials))


def _read(path: Path, fingerprint: str) -> SavedTrials | None:
    try:
        arrays = read_arrays(path)
        if str(arrays.pop("fingerprint")) != fingerprint:
            return None
        wall_clock_s, code = float(arrays.pop("wall_clock_s")), tuple(arrays.pop("code").tolist())
        trials = from_arrays(HeldOutTrials, arrays, {"metrics": TrackTrials, "values": dict, "moments": dict})
        return SavedTrials(trials, wall_clock_s, code)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile, zlib.error) as error:
        print(f"'{path}' is damaged ({error}); its trials are walked anew.", file=sys.stderr)
        return None


def _resize(values: NDArray[Any], protocol: HeldOutProtocol) -> NDArray[Any]:
    """Values [T, ...] for as many trials in each cell as the protocol has; missing ones are zero."""
    cells = values.reshape(protocol.num_cells, -1, *values.shape[1:])
    kept = cells[:, : protocol.trials]
    result = np.zeros((protocol.num_cells, protocol.trials, *values.shape[1:]), dtype=values.dtype)
    result[:, : kept.shape[1]] = kept
    return result.reshape(-1, *values.shape[1:])
