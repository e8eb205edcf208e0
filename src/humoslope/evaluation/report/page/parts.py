"""What there is of a trained policy on the disk: its run, and every result that was measured of it.

Results are found in the folder of the checkpoint, in exports beside it, and where else the user says. They belong to a
policy by the SHA-256 of its checkpoint, which every result holds, and not by their names.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from humoslope.errors import UserError
from humoslope.evaluation.report.curve import Curve, read_curves, read_table
from humoslope.learning import checkpoint as checkpoints
from humoslope.learning.configuration import trained_cfg
from humoslope.learning.policy import Provenance, find_checkpoint, provenance_of
from humoslope.learning.run_folder import starts
from humoslope.provenance import plain
from humoslope.registry import all_tasks, build_task
from humoslope.seal import read_json

RESULTS = ("ramps", "held-out", "sweep", "margins")
"""Kinds of results, by the entry "what" of their files."""

Report = dict[str, Any]


@dataclass
class Policy:
    """A trained policy and what was found of it.

    Attributes:
        name: Its name on the page.
        source: What the user gave: a run folder or a checkpoint.
        origin: Origin of the checkpoint.
        run_dir: Folder of its run; None if there is only a checkpoint.
        code: Commit that it was trained with.
        config: Its configuration as plain data; None if the checkpoint does not hold it.
        default: That of today's task; None if it is not registered here.
        curves: Its learning curves by tag; None if there are none.
        starts: Records of the starts of its run.
        results: The largest result of each of `RESULTS`; of equal ones the newest. Of ramps, those that are walked
            straight up and down count before all others, and of margins those of the export's own robot.
        rollout: A recorded walk; None if there is none.
        damaged: Files that could not be read.
    """

    name: str
    source: Path
    origin: Provenance
    run_dir: Path | None
    code: str
    config: Report | None
    default: Report | None
    curves: dict[str, Curve] | None = None
    starts: list[Report] = field(default_factory=list)
    results: dict[str, Report] = field(default_factory=dict)
    rollout: Path | None = None
    damaged: list[Path] = field(default_factory=list)

    @property
    def hashes(self) -> tuple[str, ...]:
        """SHA-256 under which results know the checkpoint."""
        return (self.origin.sha256, *self.origin.formerly)


def find_policies(sources: Sequence[str], also: Sequence[Path]) -> list[Policy]:
    """The policies, each with everything that belongs to it.

    Args:
        sources: Run folders or checkpoints, as PATH or NAME=PATH; of a run folder its newest checkpoint counts.
        also: Further files and folders in which results are looked for.

    Raises:
        UserError: If a source or a place does not exist, holds no checkpoint, or two have one name.
    """
    for place in also:
        if not place.exists():
            raise UserError(f"report: '{place}' does not exist.")
    policies: list[Policy] = []
    for source in sources:
        policy = _policy(source)
        if policy.name in (other.name for other in policies):
            raise UserError(f"report: there are two called '{policy.name}'; name them as NAME=PATH.")
        _collect(policy, also)
        policies.append(policy)
    return policies


def _policy(source: str) -> Policy:
    name, equals, given = source.partition("=")
    if not equals or Path(source).exists():
        name, given = "", source
    path = find_checkpoint(Path(given))
    state = checkpoints.load(path)
    run_dir = path.parent if (path.parent / "starts").is_dir() or any(path.parent.glob("events.out.*")) else None
    folder = Path(given).resolve()
    task = state["task"]
    return Policy(
        name=name or (folder.name if folder.is_dir() else path.stem),
        source=Path(given),
        origin=provenance_of(path, state),
        run_dir=run_dir,
        code=state["code"],
        config=_plain_config(path, state),
        default=_as_plain(build_task(task)) if task in all_tasks() else None,
    )


def _plain_config(path: Path, state: Mapping[str, Any]) -> Report | None:
    if state["config"] is None:
        return None
    try:
        return _as_plain(trained_cfg(path, state))
    except UserError:  # it names what does not exist any more
        return None


def _as_plain(cfg: Any) -> Report:
    env = plain(cfg.env)
    env["scene"]["robot"] = cfg.env.scene.robot.name
    return {"env": env, "agent": plain(cfg.agent)}


def _collect(policy: Policy, also: Sequence[Path]) -> None:
    """Fills in everything that is found of a policy."""
    if policy.run_dir is not None:
        policy.starts = [
            record for folder in starts(policy.run_dir) if (record := _json(folder / "start.json", policy))
        ]
        for folder, record in zip(starts(policy.run_dir), policy.starts, strict=False):
            record["options"] = _text(folder / "options.txt")
            record["git"] = _text(folder / "git.txt")
    policy.curves = _curves(policy, also)
    places = [policy.origin.path.parent, *also]
    weights: dict[str, tuple[float, ...]] = {}
    for path in _files(places, ".json"):
        report = _json(path, policy)
        what = report.get("what") if report else None
        if report is None or what not in RESULTS or not _belongs(report, policy.hashes):
            continue
        weight = (*_weight(report), path.stat().st_mtime)
        if weight > weights.get(what, ()):
            weights[what] = weight
            policy.results[what] = report
    rollouts = [path for path in _files(places, ".npz") if _is_rollout_of(path, policy.hashes)]
    policy.rollout = max(rollouts, key=lambda path: path.stat().st_mtime, default=None)


def _files(places: Sequence[Path], suffix: str) -> Iterator[Path]:
    """Files with this suffix in these places: in folders themselves and in those directly in them."""
    seen: set[Path] = set()
    for place in places:
        found = [place] if place.is_file() else sorted({*place.glob(f"*{suffix}"), *place.glob(f"*/*{suffix}")})
        for path in found:
            if path.suffix == suffix and path.resolve() not in seen:
                seen.add(path.resolve())
                yield path


def _weight(report: Report) -> tuple[float, float]:
    """What tells the result to show from others of its kind."""
    if report["what"] == "margins":
        return float(report.get("model") is None), float(len(report["quantities"]))
    protocol = report.get("protocol")
    asked = protocol if isinstance(protocol, dict) else {}
    straight = float(asked.get("speed", 0.0) > 0.0 and not asked.get("across") and not asked.get("push"))
    ramps = report.get("ramps") or []
    return straight, float(report.get("finished") or sum(r["falls"]["total"] for r in ramps))


def _belongs(report: Report, hashes: Sequence[str]) -> bool:
    """True if a result was measured of a checkpoint with one of these hashes, and of no other."""
    records = report.get("checkpoints") or [report.get("checkpoint") or report.get("policy") or {}]
    return all(isinstance(r, dict) and r.get("sha256") in hashes for r in records)


def _is_rollout_of(path: Path, hashes: Sequence[str]) -> bool:
    try:
        with np.load(path, allow_pickle=False) as archive:
            if "header" not in archive.files:
                return False
            header = json.loads(str(archive["header"]))
            return header["checkpoint"]["sha256"] in hashes
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error):
        return False


def _curves(policy: Policy, also: Sequence[Path]) -> dict[str, Curve] | None:
    if policy.run_dir is not None:
        try:
            return read_curves(policy.run_dir)
        except UserError:
            pass
    wanted = f"{policy.origin.path.stem}_curve.csv"
    tables = [path for path in _files([policy.origin.path.parent, *also], ".csv") if path.name == wanted]
    return read_table(tables[0]) if tables else None


def _json(path: Path, policy: Policy) -> Report | None:
    try:
        content = read_json(path)
    except (OSError, ValueError, RecursionError):
        policy.damaged.append(path)
        return None
    return content if isinstance(content, dict) else None


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").strip()
    except (OSError, ValueError):
        return ""


ABSENT = "absent"
"""Value of a field that a configuration does not have."""


def differing(policies: Sequence[Policy]) -> dict[str, list[Any]]:
    """Fields in which a policy differs from today's task, or policies from each other: path -> default, then each one.

    The value of a policy without a configuration is None. The default is that of the first policy's task.
    """
    columns = [policies[0].default, *(policy.config for policy in policies)]
    there = [column for column in columns if column is not None]
    found = iter(_differences(there))
    return {
        path: [None if column is None else next(own) for column in columns]
        for path, values in found
        for own in [iter(values)]
    }


def _differences(values: Sequence[Any], path: str = "") -> Iterator[tuple[str, list[Any]]]:
    """Paths at which values differ, with all of them. Below a part that one of them lacks nothing is told apart."""
    if all(isinstance(value, Mapping) for value in values):
        for name in dict.fromkeys(name for value in values for name in value):
            inner = [value.get(name, ABSENT) for value in values]
            yield from _differences(inner, f"{path}.{name}" if path else str(name))
    elif len({json.dumps(value) for value in values}) > 1:
        yield path, list(values)
