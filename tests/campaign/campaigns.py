"""Campaigns for tests: a small one, tasks that need no building, and stand-ins for the processes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import IO

from humoslope.campaign.file import Campaign, read_campaign
from humoslope.campaign.plan import Plan, Scale, make_plan
from humoslope.errors import UserError

FIRST, SECOND = "HumoSlope-Stage1-Unitree-G1", "HumoSlope-Stage2-Unitree-G1"
SMALL = f"""
preset = "cpu"
seeds = [1, 2]
options = "--env.num-envs 16"
calibrate = "--starts 2"

[train.full]
task = "{SECOND}"
parent = "stage1"
steps = 700

[train.stage1]
task = "{FIRST}"
iterations = 10

[evaluate.track]
kind = "held-out"
grades = [20]
trials = 4

[evaluate.ramps]
kind = "ramps"
of = ["stage1"]
trials = 8
"""


def scale(task: str, preset: str, options: Sequence[str]) -> Scale:
    """16 envs and 4 steps of each in an iteration; Stage II starts from Stage I and its calibration."""
    if task not in (FIRST, SECOND):
        raise UserError(f"task '{task}' does not exist.")
    if "--bad" in options:
        raise UserError("Unrecognized options: --bad.")
    later = {"start": FIRST, "calibrated": "swing_hip"} if task == SECOND else {}
    return Scale(num_envs=16, samples=64, save_interval=5, preset="cpu", **later)


def read(folder: Path, text: str = SMALL) -> Campaign:
    path = folder / "small.toml"
    path.write_text(text, encoding="utf-8")
    return read_campaign(path)


def plan(folder: Path, text: str = SMALL) -> Plan:
    return make_plan(read(folder, text), folder / "out", scale, lambda evaluation: 1000)


class Ended:
    """A process that has ended."""

    def __init__(self, code: int) -> None:
        self.code = code

    def poll(self) -> int:
        return self.code

    def wait(self) -> int:
        return self.code

    def send_signal(self, sig: int) -> None:
        raise AssertionError("there is nobody to send a signal to")

    kill = poll


class Humoslope:
    """Starts nothing, but leaves what the verbs would leave, and refuses to read what is not there.

    Attributes:
        ran: What it was asked to do.
        fails: Words of which one in a command makes it fail.
    """

    def __init__(self) -> None:
        self.ran: list[list[str]] = []
        self.env: list[Mapping[str, str]] = []
        self.fails: set[str] = set()

    def __call__(self, words: list[str], env: Mapping[str, str], log: IO[bytes]) -> Ended:
        self.ran.append(words)
        self.env.append(env)
        if any(part in word for part in self.fails for word in words):
            log.write(b"begun\nhumoslope: it cannot walk.\n")
            log.flush()
            return Ended(2)
        verb, options = words[0], dict(pairwise(words))
        for name in ("--init", "--calibration"):
            assert Path(options.get(name, __file__)).exists(), words
        if verb == "train":
            self.train(words, Path(options.get("--run-dir") or options["--resume"]), options["--agent.max-iterations"])
        else:
            assert Path(words[1]).is_file(), words
            out = Path(options["--out"])
            self.measure(words, out if verb != "evaluate" else out.with_name(out.name + ".json"))
        return Ended(0)

    def train(self, words: list[str], folder: Path, iterations: str) -> None:
        if "--run-dir" in words:
            assert not list(folder.glob("*")), "a new run into an old folder"
            leave_run(folder, words)
        (folder / f"model_{int(iterations) - 1}.pt").write_bytes(b"x" * 1000)
        (folder / "console.log").write_text(
            f"{iterations}/{iterations}  0.00 M steps  2,000/s  reward 0.1  left 0:00:00\n"
        )

    def measure(self, words: list[str], out: Path) -> None:
        iteration = int(Path(words[1]).stem.split("_")[1])
        source = {"iteration": iteration, "task": FIRST}
        report = {"checkpoint": source, "checkpoints": [source], "wall_clock_s": 30.0}
        report["command_line"] = " ".join(["humoslope", *words])
        out.write_text(json.dumps(report))


def leave_run(folder: Path, words: list[str], origin: str | None = None) -> None:
    """What a training leaves of its start."""
    options = [word for word in words[2:] if word]
    kept: list[str] = []
    for i, word in enumerate(options):
        before = options[i - 1] if i else ""
        if not {word, before} & {"--run-dir", "--init", "--calibration"}:
            kept.append(word)
    start = folder / "starts" / "1"
    start.mkdir(parents=True)
    parent = options[options.index("--init") + 1] if "--init" in options else origin
    about = {"task": words[1], "total_steps": 0, "from": parent}
    (start / "start.json").write_text(json.dumps(about))
    (start / "options.txt").write_text(" ".join(kept))
