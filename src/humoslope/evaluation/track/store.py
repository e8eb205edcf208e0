"""Finished trials on disk, so that an evaluation that was interrupted goes on."""

from __future__ import annotations

import hashlib
import json
import zipfile
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
from humoslope.evaluation.track.trials import HeldOutTrials, Relay
from humoslope.files import write_atomically
from humoslope.provenance import plain


class Walked(NamedTuple):
    """What a file holds.

    Attributes:
        trials: With gaps where they are not finished yet.
        wall_clock_s: What they took in all calls.
        code: Commits that they were walked with.
    """

    trials: HeldOutTrials
    wall_clock_s: float
    code: tuple[str, ...]


def fingerprint(cfg: EnvCfg, relay: Relay, sha256: str) -> str:
    """A hash of what decides the outcome of a trial: protocol, ground, environment, machine and checkpoint.

    How many trials there are is not in it, so that a first look with a few of them is the beginning of a full one.

    Args:
        sha256: Of the checkpoint.
    """
    protocol = asdict(relay.protocol)
    del protocol["trials"]
    # Of the files that describe the robot it is what they say that counts, not where they lie; meshes only look.
    robot = cfg.scene.robot
    described = plain(robot) | {"urdf": hashlib.sha256(robot.urdf.read_bytes()).hexdigest(), "meshes": None}
    whole = {
        "protocol": protocol,
        "lanes": relay.lanes,
        "ground": hashlib.sha256(cfg.scene.terrain.build().heights.tobytes()).hexdigest(),
        "segments": plain(relay.course.segments),
        "environment": {name: plain(value) for name, value in vars(cfg).items() if name != "scene"},
        "robot": described,
        # Not how many threads there are: trials run on one.
        "machine": [torch.cuda.is_available(), torch.__version__, mujoco.__version__],
        "metrics": [METRICS_VERSION, *(metric.name for metric in RECORDED)],
        "checkpoint": sha256,
    }
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()


def save(path: Path, walked: Walked, mark: str, protocol: HeldOutProtocol) -> None:
    """Writes the trials of a protocol and the fingerprint they belong to in one step.

    Trials beyond the protocol's that the file holds under the same fingerprint stay in it.
    """
    trials, before = walked.trials, _read(path, mark)
    if before is not None and len(before.trials) > len(trials):
        larger = replace(protocol, trials=len(before.trials) // protocol.num_cells)
        padded = map_arrays(partial(_resize, protocol=larger), trials)
        trials = map_arrays(partial(where_arrays, padded.finished), padded, before.trials)
    about = {"fingerprint": mark, "wall_clock_s": walked.wall_clock_s, "code": walked.code}
    arrays: dict[str, Any] = {name: np.array(value) for name, value in about.items()} | to_arrays(trials)
    write_atomically(path, lambda temporary: np.savez_compressed(temporary, **arrays))


def load(path: Path, mark: str, protocol: HeldOutProtocol) -> Walked | None:
    """The trials saved at `path` as far as this protocol has them, if they have this fingerprint.

    None if there is no such file, or it belongs to something else.
    """
    found = _read(path, mark)
    if found is None:
        return None
    return found._replace(trials=map_arrays(partial(_resize, protocol=protocol), found.trials))


def _read(path: Path, mark: str) -> Walked | None:
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
        if str(arrays.pop("fingerprint")) != mark:
            return None
        wall_clock_s, code = float(arrays.pop("wall_clock_s")), tuple(arrays.pop("code").tolist())
        return Walked(from_arrays(HeldOutTrials, arrays, {"metrics": TrackTrials, "values": dict}), wall_clock_s, code)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _resize(values: NDArray[Any], protocol: HeldOutProtocol) -> NDArray[Any]:
    """Results [T, ...] for as many trials in each cell as the protocol has; those there are not yet are all zero."""
    cells = values.reshape(protocol.num_cells, -1, *values.shape[1:])
    kept = cells[:, : protocol.trials]
    result = np.zeros((protocol.num_cells, protocol.trials, *values.shape[1:]), dtype=values.dtype)
    result[:, : kept.shape[1]] = kept
    return result.reshape(-1, *values.shape[1:])
