"""`humoslope compare` sets training runs side by side at equal samples."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from torch.utils.tensorboard import SummaryWriter

from humoslope.cli import main
from humoslope.evaluation.report.compare import shortened
from humoslope.evaluation.report.curve import STEPS

ROOT = Path(__file__).parents[2]


def train(folder: Path, steps: float, iterations: int, speed: float, options: str) -> Path:
    """A run whose speed grows by `speed` with every iteration."""
    writer = SummaryWriter(folder)
    for i in range(iterations):
        writer.add_scalar(STEPS, steps * (i + 1), i)
        writer.add_scalar("Train/speed", speed * (i + 1), i)
    writer.close()
    (folder / "options.txt").write_text(options)
    return folder


@pytest.fixture
def runs(tmp_path: Path) -> list[str]:
    """One of 40 iterations of 1000 steps, and one of 100 of 500."""
    common = "--preset cpu --env.seed 1"
    first = train(tmp_path / "first", 1000.0, 40, 0.01, common)
    second = train(tmp_path / "second", 500.0, 100, 0.02, f"{common} --env.command.speed 0.2 0.4")
    return [str(first), str(second)]


def table(path: Path) -> dict[str, dict[str, str]]:
    return {row["method"]: row for row in csv.DictReader(path.read_text().splitlines())}


def test_runs_are_compared_after_as_many_steps_as_the_shortest_has(
    runs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", *runs, "--out", str(tmp_path / "a.csv")]) == 0
    assert "0.04 million environment steps" in capsys.readouterr().out
    rows = table(tmp_path / "a.csv")
    # The last tenth of 40,000 steps: iterations 37 to 40 of the first, 73 to 80 of the second.
    assert float(rows["first"]["speed m/s"]) == pytest.approx(0.01 * 38.5)
    assert float(rows["second"]["speed m/s"]) == pytest.approx(0.02 * 76.5)


def test_what_runs_differ_in_stands_beside_them(runs: list[str], tmp_path: Path) -> None:
    assert main(["compare", *runs, "--at", "20000", "--out", str(tmp_path / "a.md")]) == 0
    text = (tmp_path / "a.md").read_text()
    assert "| second | --env.command.speed 0.2 0.4 | 0.770 |" in text
    assert "| first |  | 0.195 |" in text
    assert "--preset" not in text


def test_many_differences_are_counted() -> None:
    assert shortened(["--a 1", "--b 2"]) == "--a 1 --b 2"
    assert shortened(["--a 1", "--b 2", "--c 3", "--d 4"]) == "--a 1 --b 2 and 2 more"


def test_mistakes_are_said_in_one_sentence(mistake: Callable[..., str], runs: list[str], tmp_path: Path) -> None:
    assert "one run folder or more" in mistake("compare")
    assert "does not exist" in mistake("compare", str(tmp_path / "nowhere"))
    assert "first' has 40,000 environment steps" in mistake("compare", *runs, "--at", "45000")
    assert "must end in .md or .csv" in mistake("compare", *runs, "--out", str(tmp_path / "a.png"))


def recipe(out: Path, programs: Path) -> subprocess.CompletedProcess[str]:
    """What `make recipe` would do with the `python` and `humoslope` in the folder `programs`."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    clean["PYTHONPATH"] = os.pathsep.join((str(ROOT / "src"), str(ROOT)))
    words = ["make", "-n", "-f", "experiments/recipe.mk", f"BIN={programs}", f"OUT={out}/runs", f"TABLE={out}/table.md"]
    return subprocess.run(words, cwd=ROOT, env=clean, capture_output=True, text=True, check=False)


def test_the_recipe_ends_if_the_rewards_cannot_be_halved(tmp_path: Path) -> None:
    done = recipe(tmp_path, tmp_path / "nowhere")
    assert done.returncode != 0
    assert "half-rewards" in done.stderr
    assert "cannot list the rewards" in done.stderr
    assert "half-rewards" not in done.stdout


def test_the_recipe_is_compared_by_options_that_exist(tmp_path: Path) -> None:
    done = recipe(tmp_path, Path(sys.executable).parent)
    assert done.returncode == 0, done.stderr
    printed = done.stdout
    trainings = [line.split()[1:] for line in printed.splitlines() if "humoslope train" in line]
    assert len(trainings) == 10
    assert len({" ".join(words[words.index("--env.num-envs") :]) for words in trainings}) == 10
    for verb, task, *options in trainings:
        small = ["--env.num-envs", "2", "--agent.num-steps-per-env", "2", "--agent.max-iterations", "1"]
        small += ["--agent.num-mini-batches", "1", "--env.scene.terrain.levels", "2"]
        assert main([verb, task, *options, *small]) == 0
    assert f"compare {tmp_path}/runs/recipe" in printed
