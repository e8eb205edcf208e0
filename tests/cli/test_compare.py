"""`humoslope compare` sets training runs side by side at equal samples."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import pytest
from torch.utils.tensorboard import SummaryWriter

from humoslope.cli import main
from humoslope.evaluation.report.bands import band
from humoslope.evaluation.report.compare import shortened
from humoslope.evaluation.report.curve import STEPS, read_curves, write_table


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


@pytest.fixture
def seeds(tmp_path: Path) -> list[str]:
    """Three runs of a method, three of one that walks faster, and one of a third."""
    folders = []
    for row, seed, speed in (
        *(("slow", s, 0.010 + 0.0002 * s) for s in (1, 2, 3)),
        *(("fast", s, 0.020 + 0.0002 * s) for s in (1, 2, 3)),
        ("alone", 1, 0.016),
    ):
        calibrated = f"--env.rewards.swing-hip.params.beta0 {0.1 * seed}"
        options = f"--preset cpu --agent.gamma {0.9 if row == 'fast' else 0.99} --env.seed {seed} {calibrated}"
        folders.append(str(train(tmp_path / row / f"seed{seed}", 1000.0, 20, speed, options)))
    return folders


def test_runs_that_differ_in_their_seed_are_a_row_and_told_apart_only_where_the_seeds_carry_it(
    seeds: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", *seeds, "--out", str(tmp_path / "a.md"), "--curves", str(tmp_path / "a.png")]) == 0
    said = capsys.readouterr().out
    assert "Differences from slow" in said
    text = (tmp_path / "a.md").read_text()
    # 20,000 steps; the last tenth is the iterations 19 and 20.
    assert "| slow | 3 seeds --agent.gamma 0.99 | 0.203 (" in text
    assert "| alone/seed1 | 1 seed --agent.gamma 0.99 | 0.312 |" in text
    differing = text[text.index("Differences") :]
    assert "| fast | 3 seeds --agent.gamma 0.9 | +0.195 (+0.1" in differing
    assert "| fast | 3 seeds --agent.gamma 0.9 | higher |" in differing
    assert "| alone/seed1 | 1 seed --agent.gamma 0.99 | one seed |" in differing
    assert (tmp_path / "a.png").is_file()


def test_every_run_can_have_a_row_of_its_own(seeds: list[str], tmp_path: Path) -> None:
    assert main(["compare", *seeds, "--each", "--out", str(tmp_path / "a.csv")]) == 0
    assert list(table(tmp_path / "a.csv")) == [
        *(f"{row}/seed{seed}" for row in ("slow", "fast") for seed in (1, 2, 3)),
        "alone/seed1",
    ]


def test_the_band_goes_from_the_lowest_to_the_highest_seed() -> None:
    steps = {i: 1000.0 * (i + 1) for i in range(10)}
    curves = [{STEPS: steps, "Train/speed": dict.fromkeys(range(10), level)} for level in (1.0, 2.0, 6.0)]
    x, mean, low, high = band(curves, "Train/speed", points=4)
    assert list(x) == [1000.0, 4000.0, 7000.0, 10000.0]
    assert (set(mean), set(low), set(high)) == ({3.0}, {1.0}, {6.0})
    assert list(band(curves, "Train/speed", at=4000.0, points=4)[0]) == [1000.0, 2000.0, 3000.0, 4000.0]
    assert band(curves, "Train/speed", at=20_000.0)[0][-1] == 10_000.0


def test_curves_end_where_the_runs_are_compared(
    seeds: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends = []

    def drawn(*given: object, **named: object) -> object:
        found = band(*given, **named)  # type: ignore[arg-type]
        ends.append(found[0][-1])
        return found

    monkeypatch.setattr("humoslope.evaluation.report.bands.band", drawn)
    for options, end in (((), 20_000.0), (("--at", "12000"), 12_000.0)):
        ends.clear()
        assert main(["compare", *seeds, *options, "--curves", str(tmp_path / "a.png")]) == 0
        assert set(ends) == {end}


def test_a_run_without_event_files_may_have_its_curves_in_a_table(runs: list[str], tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    write_table(read_curves(Path(runs[0])), kept / "curve.csv")
    assert main(["compare", runs[0], str(kept), "--each", "--out", str(tmp_path / "a.csv")]) == 0
    rows = table(tmp_path / "a.csv")
    assert float(rows["kept"]["speed m/s"]) == pytest.approx(float(rows["first"]["speed m/s"]), rel=1e-4)


def test_a_picture_without_an_ending_is_a_png(seeds: list[str], tmp_path: Path) -> None:
    assert main(["compare", *seeds, "--curves", str(tmp_path / "curves")]) == 0
    assert (tmp_path / "curves.png").is_file()


def test_a_run_that_is_given_twice_is_refused(runs: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", runs[0], runs[1], f"{runs[0]}/../first"]) == 2
    assert "is given twice; it would count twice." in capsys.readouterr().err
