"""`make reproduce`: the whole chain in its order, going on where it was stopped. Stand-ins take the place of the verbs;
`test_chain` runs real ones."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from humoslope.cli.options import parse
from humoslope.cli.train import TrainArgs
from humoslope.registry import load_content

ROOT = Path(__file__).parents[2]

# Writes down what it was asked, refuses to read what is not there, and leaves what the verb would leave.
STAND_IN = """#!{python} -IS
import sys
from pathlib import Path

words = sys.argv[1:]
with open("{log}", "a") as log:
    print(*words, file=log)
options = dict(zip(words, words[1:]))
reads = [word for word in words[1:] if word.startswith("{out}") and word not in options.get("--out", "")]
reads = [word for word in reads if word != options.get("--run-dir")]
missing = [word for word in reads if not Path(word).exists()]
if missing:
    sys.exit(f"{{words}} reads {{missing}}")
if words[0] == "train":
    run = Path(options.get("--run-dir") or options["--resume"])
    run.mkdir(parents=True, exist_ok=True)
    for iteration in (4, 6):
        (run / f"model_{{iteration}}.pt").touch()
elif words[0] in ("ramps", "calibrate"):
    Path(options["--out"]).touch()
elif words[0] == "evaluate":
    out = Path(options["--out"] + ".json")
    out.parent.mkdir(exist_ok=True)
    out.touch()
"""


@pytest.fixture
def reproduce(tmp_path: Path):
    out, log, program = tmp_path / "out", tmp_path / "log", tmp_path / "bin" / "humoslope"
    program.parent.mkdir()
    program.write_text(STAND_IN.format(python=sys.executable, log=log, out=out), encoding="utf-8")
    program.chmod(0o755)

    def run() -> list[str]:
        log.unlink(missing_ok=True)
        words = ["make", "-f", "experiments/reproduce.mk", f"BIN={program.parent}", f"OUT={out}"]
        words += ["ITERATIONS=7", "WALKS=4"]
        # Not as part of the make that may run the tests.
        clean = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
        done = subprocess.run(words, cwd=ROOT, env=clean, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return log.read_text(encoding="utf-8").splitlines()

    run.out = out
    return run


def verbs(lines: list[str]) -> list[str]:
    return [" ".join(line.split()[:2]) if line.startswith("train") else line.split()[0] for line in lines]


def test_every_step_finds_what_the_earlier_ones_left(reproduce) -> None:
    lines = reproduce()
    assert sorted(verbs(lines)) == sorted(
        [
            "train HumoSlope-Stage1-Unitree-G1",
            "train HumoSlope-Stage2-Unitree-G1",
            "train URL-TerrainRelative-Unitree-G1",
            "calibrate",
            "ramps",
            *["evaluate"] * 6,
            *["table"] * 2,
            "figures",
        ]
    )
    assert sum("--sweep" in line for line in lines) == 3
    stage2 = next(line for line in lines if "Stage2" in line)
    assert f"--init {reproduce.out}/stage1/model_6.pt --calibration {reproduce.out}/stage1/swing.json" in stage2
    assert "--env.num-envs 1024 --agent.max-iterations 7" in stage2


def test_what_is_done_is_not_done_again(reproduce) -> None:
    reproduce()
    assert verbs(reproduce()) == ["table", "table", "figures"]


def test_a_training_that_was_stopped_goes_on(reproduce) -> None:
    run = reproduce.out / "stage1"
    run.mkdir(parents=True)
    (run / "model_3.pt").touch()
    first = next(line for line in reproduce() if "Stage1" in line)
    assert first == f"train HumoSlope-Stage1-Unitree-G1 --resume {run}"


def test_the_baseline_learns_as_stage_1_does_from_its_first_walk(reproduce) -> None:
    load_content()
    runs = {}
    for line in reproduce():
        if line.startswith("train") and "Stage2" not in line:
            _, task, *options = line.split()
            cfg, args = parse(TrainArgs(), task, [*options, "--preset", "cpu"])
            runs[task] = (args.init, cfg.agent)
    init, agent = runs["URL-TerrainRelative-Unitree-G1"]
    assert init == f"{reproduce.out}/stage1/model_4.pt"
    assert agent.critic_warmup_iterations > 0
    assert replace(agent, critic_warmup_iterations=0) == runs["HumoSlope-Stage1-Unitree-G1"][1]
