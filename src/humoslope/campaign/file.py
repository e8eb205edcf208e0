"""The file that describes a campaign, a table of trainings and evaluations in TOML.

    preset = "cpu"                            # scale of every training, see `humoslope train --help`
    seeds = [1, 2, 3]                         # of every row that names none
    options = "--env.num-envs 1024"           # of every training, as typed after `humoslope train TASK`
    calibrate = "--starts 64"                 # of every calibration, as typed after `humoslope calibrate CHECKPOINT`

    [train.stage1]                            # a row, by its name
    task = "HumoSlope-Stage1-Unitree-G1"
    steps = 30e6                              # or iterations = 1221

    [train.full]
    task = "HumoSlope-Stage2-Unitree-G1"
    parent = "stage1"                         # that row at the same seed; or a checkpoint, from this file's folder
    steps = 20e6

    [evaluate.track]                          # the results' name
    kind = "held-out"                         # or "sweep", or "ramps"
    of = ["full"]                             # rows; all of them if it is left out
    grades = [20, 30]                         # degrees
    trials = 32                               # in each cell, or on each ramp
    options = "--tiers 0.6"                   # as typed after `humoslope evaluate CHECKPOINT` or `humoslope ramps`

More keys of a row: `seeds`, `options`, which add to those of the file and win over them, `parent-iteration` for an
earlier checkpoint of the parent, and `calibration`, a file or "prior". A task whose reward is calibrated needs nothing:
the calibration of its parent is made in between.
"""

from __future__ import annotations

import difflib
import re
import shlex
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, Literal, get_args

from humoslope.errors import UserError

Kind = Literal["held-out", "sweep", "ramps"]
KINDS = get_args(Kind)
PRESETS = ("auto", "cpu", "gpu")
PRIOR = "prior"
"""In place of a calibration's path: the values that the task's configuration has."""

TRAIN, CALIBRATE = "training", "calibration"
"""Columns of jobs that are no evaluations."""
TAKEN = (TRAIN, CALIBRATE, "starts", "diverged", "videos")
"""Names that an evaluation cannot have: those of columns, and of what else lies in a run folder."""
WATCHING = ("--watch", "--watch-worlds", "--web-port", "--port")
"""Options of a training that show it live: several would share one port, and nobody reads their address."""

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
OWN_OF_TRAINING = {
    "--env.seed": "'seeds'",
    "--agent.max-iterations": "'steps' or 'iterations'",
    "--preset": "'preset'",
    "--init": "'parent'",
    "--calibration": "'calibration'",
    "--run-dir": "the campaign",
    "--resume": "the campaign",
}
"""Options that a row must not have, and what sets them."""
OWN_OF_TRAINING |= dict.fromkeys(WATCHING, "only a training that you start yourself")
OWN_OF_EVALUATION = {"--out": "the campaign", "--sweep": "'kind'", "--fresh": "the campaign"}


@dataclass(frozen=True)
class Training:
    """A row of trainings, one for each seed.

    Attributes:
        name: Name of the row.
        task: Name of the task.
        seeds: Seeds, each once.
        steps: Environment steps; 0 if `iterations` are given.
        iterations: Iterations; 0 if `steps` are given.
        parent: Row whose result at the same seed it starts from; "" for none.
        checkpoint: Checkpoint that it starts from instead; None for none.
        parent_iteration: Iteration of the parent's checkpoint; None for its last one.
        calibration: Path of a swing calibration, or `PRIOR`; "" for that of the parent.
        options: Options as typed on the command line, those of the file first.
    """

    name: str
    task: str
    seeds: tuple[int, ...]
    steps: float
    iterations: int
    parent: str
    checkpoint: Path | None
    parent_iteration: int | None
    calibration: str
    options: tuple[str, ...]


@dataclass(frozen=True)
class Evaluation:
    """An evaluation of the results of some rows.

    Attributes:
        name: Name of its results.
        kind: What is measured.
        of: Names of the rows.
        words: Options as typed on the command line.
    """

    name: str
    kind: Kind
    of: tuple[str, ...]
    words: tuple[str, ...]


@dataclass(frozen=True)
class Campaign:
    """Contents of a campaign file.

    Attributes:
        path: The file.
        preset: Scale of every training.
        calibrate: Options of every calibration.
        trainings: Rows by name, in the order of the file.
        evaluations: Evaluations by name, in the order of the file.
    """

    path: Path
    preset: Literal["auto", "cpu", "gpu"]
    calibrate: tuple[str, ...]
    trainings: dict[str, Training]
    evaluations: dict[str, Evaluation]


def read_campaign(path: Path) -> Campaign:
    """Reads a campaign file. Tasks and their options are not looked at yet.

    Raises:
        UserError: If it cannot be read, or a value is impossible; the sentence names the key.
    """
    try:
        with path.open("rb") as file:
            content = tomllib.load(file)
    except FileNotFoundError:
        raise UserError(f"campaign '{path}' does not exist.") from None
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"campaign '{path}' cannot be read: {getattr(error, 'strerror', None) or error}.") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise UserError(f"campaign '{path}' is no TOML: {error}.") from None
    return _Reader(path).campaign(content)


class _Reader:
    """Reads values by their keys; every mistake names the file and the key."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def campaign(self, content: Mapping[str, Any]) -> Campaign:
        self._know(content, "", ("preset", "seeds", "options", "calibrate", "train", "evaluate"))
        preset = self._text(content, "", "preset", "auto")
        if preset not in PRESETS:
            raise self.mistake("preset", f"is '{preset}'; it must be one of {', '.join(PRESETS)}")
        seeds = self._seeds(content, "", (1,))
        options = self._words(content, "", "options", OWN_OF_TRAINING)
        calibrate = self._words(content, "", "calibrate", OWN_OF_EVALUATION)
        rows = self._tables(content, "train")
        if not rows:
            raise self.mistake("train", "has no row; a campaign needs at least one, such as [train.stage1]")
        trainings = {name: self._training(name, row, seeds, options, rows) for name, row in rows.items()}
        self._check_descent(trainings)
        tables = self._tables(content, "evaluate")
        evaluations = {name: self._evaluation(name, table, trainings) for name, table in tables.items()}
        return Campaign(self._path, preset, calibrate, trainings, evaluations)  # type: ignore[arg-type]

    def _training(
        self, name: str, row: Mapping[str, Any], seeds: tuple[int, ...], options: tuple[str, ...], rows: Iterable[str]
    ) -> Training:
        at = f"train.{name}"
        known = ("task", "seeds", "steps", "iterations", "parent", "parent-iteration", "calibration", "options")
        self._know(row, at, known)
        task = self._text(row, at, "task")
        if ("steps" in row) == ("iterations" in row):
            raise self.mistake(at, "needs either 'steps' or 'iterations'")
        steps = self._number(row, at, "steps", 0.0)
        iterations = self._whole(row, at, "iterations", 0)
        for key, value in (("steps", steps), ("iterations", iterations)):
            if key in row and not 0 < value < 1e15:
                raise self.mistake(f"{at}.{key}", f"is {value:g}; it must be positive")
        parent = self._text(row, at, "parent", "")
        checkpoint = None
        if parent and parent not in rows:
            checkpoint = self._checkpoint(f"{at}.parent", parent, rows)
            parent = ""
        at_iteration = self._whole(row, at, "parent-iteration", -1) if "parent-iteration" in row else None
        if at_iteration is not None and (at_iteration < 0 or not parent):
            raise self.mistake(f"{at}.parent-iteration", "must be 0 or more, and needs a row as 'parent'")
        calibration = self._text(row, at, "calibration", "")
        if calibration and calibration != PRIOR:
            calibration = str(self._file(f"{at}.calibration", calibration))
        return Training(
            name=name,
            task=task,
            seeds=self._seeds(row, at, seeds),
            steps=steps,
            iterations=iterations,
            parent=parent,
            checkpoint=checkpoint,
            parent_iteration=at_iteration,
            calibration=calibration,
            options=(*options, *self._words(row, at, "options", OWN_OF_TRAINING)),
        )

    def _evaluation(self, name: str, table: Mapping[str, Any], rows: Mapping[str, Training]) -> Evaluation:
        at = f"evaluate.{name}"
        if name in TAKEN:
            raise self.mistake(
                at, f"cannot have this name, which something else in a run folder has: {', '.join(TAKEN)}"
            )
        self._know(table, at, ("kind", "of", "grades", "trials", "options"))
        kind = self._text(table, at, "kind")
        if kind not in KINDS:
            raise self.mistake(f"{at}.kind", f"is '{kind}'; it must be one of {', '.join(KINDS)}")
        of = table.get("of", list(rows))
        if not isinstance(of, list) or not of:
            raise self.mistake(f"{at}.of", "must be a list of rows")
        for row in of:
            if row not in rows:
                raise self.mistake(f"{at}.of", f"names the row '{row}', which does not exist; {_hint(str(row), rows)}")
        grades = table.get("grades", [])
        if not isinstance(grades, list) or not all(_is_number(grade) for grade in grades):
            raise self.mistake(f"{at}.grades", "must be a list of numbers, in degrees")
        trials = self._whole(table, at, "trials", 0)
        if "trials" in table and trials < 1:
            raise self.mistake(f"{at}.trials", f"is {trials}; it must be 1 or more")
        words = ["--sweep"] if kind == "sweep" else []
        words += ["--grades", *(f"{grade:g}" for grade in grades)] if grades else []
        words += ["--starts" if kind == "ramps" else "--trials", str(trials)] if trials else []
        words += self._words(table, at, "options", OWN_OF_EVALUATION)
        return Evaluation(name, kind, tuple(of), tuple(words))  # type: ignore[arg-type]

    def _check_descent(self, rows: Mapping[str, Training]) -> None:
        """Raises a mistake if parents go round in a circle, or lack a seed that a child has."""
        try:
            TopologicalSorter({name: [row.parent] if row.parent else [] for name, row in rows.items()}).prepare()
        except CycleError as error:
            circle = [str(name) for name in error.args[1]]
            raise self.mistake(f"train.{circle[0]}.parent", f"goes round in a circle: {' <- '.join(circle)}") from None
        for name, row in rows.items():
            missing = set(row.seeds) - set(rows[row.parent].seeds) if row.parent else set()
            if missing:
                said = f"is '{row.parent}', which has no seed {min(missing)}"
                raise self.mistake(f"train.{name}.parent", said)

    def _checkpoint(self, key: str, parent: str, rows: Iterable[str]) -> Path:
        if "/" not in parent and not parent.endswith(".pt"):
            raise self.mistake(key, f"is '{parent}', which is neither a row nor a file; {_hint(parent, rows)}")
        return self._file(key, parent)

    def _file(self, key: str, name: str) -> Path:
        path = self._path.parent / name
        if not path.is_file():
            raise self.mistake(key, f"is '{name}'; there is no file '{path}'")
        return path

    def mistake(self, key: str, what: str) -> UserError:
        return UserError(f"campaign '{self._path}': {key} {what}{'' if what.endswith('?') else '.'}")

    def _know(self, table: Mapping[str, Any], at: str, known: tuple[str, ...]) -> None:
        for key in table:
            if key not in known:
                raise self.mistake(f"{at}.{key}".lstrip("."), f"is unknown; {_hint(key, known)}")

    def _tables(self, content: Mapping[str, Any], kind: str) -> dict[str, Mapping[str, Any]]:
        tables = content.get(kind, {})
        if not isinstance(tables, Mapping) or not all(isinstance(table, Mapping) for table in tables.values()):
            raise self.mistake(kind, f"must be tables, each under its name as [{kind}.NAME]")
        for name in tables:
            if not NAME.fullmatch(name):
                raise self.mistake(f"{kind}.{name!r}", "is no name of letters, digits, '-' and '_'")
        return dict(tables)

    def _text(self, table: Mapping[str, Any], at: str, key: str, default: str | None = None) -> str:
        value = table.get(key, default)
        if value is None:
            raise self.mistake(at, f"needs '{key}'")
        if not isinstance(value, str):
            raise self.mistake(f"{at}.{key}".lstrip("."), "must be text in quotes")
        return value

    def _number(self, table: Mapping[str, Any], at: str, key: str, default: float) -> float:
        value = table.get(key, default)
        if not _is_number(value):
            raise self.mistake(f"{at}.{key}", "must be a number")
        return float(value)

    def _whole(self, table: Mapping[str, Any], at: str, key: str, default: int) -> int:
        value = table.get(key, default)
        if not isinstance(value, int) or isinstance(value, bool):
            raise self.mistake(f"{at}.{key}", "must be a whole number")
        return value

    def _seeds(self, table: Mapping[str, Any], at: str, default: tuple[int, ...]) -> tuple[int, ...]:
        seeds = table.get("seeds", list(default))
        good = isinstance(seeds, list) and all(type(seed) is int and seed >= 0 for seed in seeds)
        if not good or not seeds or len(set(seeds)) < len(seeds):
            raise self.mistake(f"{at}.seeds".lstrip("."), "must be a list of whole numbers of at least 0, each once")
        return tuple(seeds)

    def _words(self, table: Mapping[str, Any], at: str, key: str, own: Mapping[str, str]) -> tuple[str, ...]:
        where, text = f"{at}.{key}".lstrip("."), self._text(table, at, key, "")
        try:
            words = tuple(shlex.split(text))
        except ValueError as error:
            raise self.mistake(where, f"cannot be read: {error}") from None
        if words and not words[0].startswith("--"):
            raise self.mistake(where, f"begins with '{words[0]}'; options begin with --")
        for word in words:
            name = word.partition("=")[0].replace("_", "-")
            if word.startswith("--") and name in own:
                raise self.mistake(where, f"has {name}, which {own[name]} sets")
        return words


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _hint(name: str, known: Iterable[str]) -> str:
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.4)
    return f"did you mean '{near[0]}'?" if near else f"there are: {', '.join(names)}"
