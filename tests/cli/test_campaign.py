"""`humoslope campaign`: one tiny campaign with real trainings, from its file to tables and what is committed of it."""

from __future__ import annotations

import io
import json
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import IO

import pytest

from humoslope.campaign import disk
from humoslope.campaign import run as queue
from humoslope.campaign.file import read_campaign
from humoslope.campaign.plan import Plan, make_plan
from humoslope.campaign.run import Run
from humoslope.cli import main
from humoslope.cli.campaign import scale_of, walk_of
from humoslope.cli.options import parse
from humoslope.cli.train import TrainArgs
from humoslope.learning import checkpoint
from humoslope.learning.policy import read_provenance
from humoslope.registry import build_task
from tests.campaign.campaigns import Ended, Humoslope

ROOT = Path(__file__).parents[2]
EXPERIMENTS = ROOT / "experiments"
WALKER = EXPERIMENTS / "checkpoints" / "stage1.pt"
FIRST, SECOND = "HumoSlope-Stage1-Unitree-G1", "HumoSlope-Stage2-Unitree-G1"
# Slowly: two updates on 64 samples each at the usual rate may throw down a policy that walks.
TINY = f"""
preset = "cpu"
seeds = [1, 2]
options = \"\"\"--env.num-envs 16 --env.sim.device cpu --env.scene.terrain.levels 3 --env.scene.terrain.num-columns 9
  --agent.num-steps-per-env 4 --agent.num-mini-batches 2 --agent.num-learning-epochs 1 --agent.no-mixed-precision
  --agent.save-interval 1 --agent.learning-rate 1e-5\"\"\"
calibrate = "--grades -10 0 10 15 20 --starts 1 --seconds 6.5 --least-samples 10"

[train.stage1]
task = "{FIRST}"
parent = "{WALKER}"
steps = 128

[train.full]
task = "{SECOND}"
parent = "stage1"
iterations = 2
seeds = [1]

[evaluate.track]
kind = "held-out"
grades = [20]
trials = 1
options = "--tiers 0.6 --timeout-s 1.4 --parallel-trials 1"

[evaluate.ramps]
kind = "ramps"
of = ["full"]
grades = [0]
trials = 1
options = "--seconds 1"
"""


def launch(words: list[str], env: Mapping[str, str], log: IO[bytes]) -> Ended:
    """Runs a verb in this process, which has all libraries loaded already."""
    out = io.TextIOWrapper(log, encoding="utf-8", write_through=True)
    with redirect_stdout(out), redirect_stderr(out):
        code = main(words)
    out.detach()
    return Ended(code)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder in which the campaign has been run, under logs/tiny."""
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "tiny.toml").write_text(TINY)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(queue, "launch", launch)
        assert main(["campaign", "tiny.toml"]) == 0
        yield folder


def plan_of(file: Path, out: Path) -> Plan:
    return make_plan(read_campaign(file), out, scale_of, walk_of)


def test_every_job_of_it_leaves_what_its_verb_leaves(folder: Path) -> None:
    plan = plan_of(folder / "tiny.toml", folder / "logs" / "tiny")
    assert len(plan.jobs) == 8
    assert set(Run(plan).states.values()) == {"done"}
    disk.check_begun(plan)
    stage2 = read_provenance(folder / "logs/tiny/full/seed1/model_1.pt")
    assert stage2.parent is not None
    assert stage2.parent.sha256 == checkpoint.digest(folder / "logs/tiny/stage1/seed1/model_1.pt")
    seeds = [checkpoint.load(folder / f"logs/tiny/stage1/seed{s}/model_1.pt")["config"]["env"]["seed"] for s in (1, 2)]
    assert seeds == [1, 2]
    assert (folder / "logs" / "tiny" / "campaign.toml").read_text() == TINY


def test_a_second_start_has_nothing_to_do_and_a_dry_run_says_so(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["campaign", "tiny.toml"]) == 0
    said = capsys.readouterr().out
    assert "8 done" in said
    assert "begins" not in said
    assert main(["campaign", "tiny.toml", "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"all +8 +8 +0\.00 +0\.00 +0\.00", said)
    assert re.search(r"At [\d,]+ steps/s of a training", said)


def test_its_folder_stands_for_its_results(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["table", "2", "logs/tiny", "--against", SECOND, "--out", str(tmp_path / "table")]) == 0
    said = capsys.readouterr().out
    assert "2 seeds" in said
    assert f"Differences from {SECOND}" in said
    rows = json.loads((tmp_path / "table.json").read_text())["rows"]
    ours = [row for row in rows if row["source"] == "ours"]
    assert [row["method"] for row in ours] == [SECOND, FIRST]
    assert ours[1]["MXD m low"] is not None
    assert main(["compare", "logs/tiny", "--curves", str(tmp_path / "curves.png")]) == 0
    said = capsys.readouterr().out
    assert "stage1" in said
    assert "2 seeds" in said
    assert (tmp_path / "curves.png").is_file()


def test_what_is_packed_is_small_and_is_gone_on_from(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    packed = tmp_path / "packed"
    assert main(["campaign", "tiny.toml", "--pack", str(packed)]) == 0
    assert "packed " in capsys.readouterr().out
    files = {str(path.relative_to(packed)) for path in packed.rglob("*") if path.is_file()}
    assert {"campaign.toml", "full/seed1/model_1.pt", "full/seed1/track.json", "full/seed1/ramps.json"} <= files
    assert {"stage1/seed2/curve.csv", "stage1/seed1/model_1.swing.json", "stage1/seed1/starts/1/start.json"} <= files
    assert not any(name.endswith((".npz", "episodes_1.pt", "config.json")) for name in files)
    whole, actor = (path / "full/seed1/model_1.pt" for path in (folder / "logs/tiny", packed))
    assert actor.stat().st_size < 0.4 * whole.stat().st_size
    assert checkpoint.digest(whole) in read_provenance(actor).formerly
    # It counts as done, for the campaign and for tables.
    plan = plan_of(folder / "tiny.toml", packed)
    disk.check_begun(plan)
    assert set(Run(plan).states.values()) == {"done"}
    assert main(["compare", str(packed)]) == 0
    assert main(["campaign", "tiny.toml", "--pack", str(packed)]) == 0
    assert "packed 0 files" in capsys.readouterr().out


def test_an_actor_alone_is_a_start_but_cannot_be_resumed(
    folder: Path, tmp_path: Path, mistake: Callable[..., str]
) -> None:
    packed = tmp_path / "packed"
    assert main(["campaign", "tiny.toml", "--pack", str(packed)]) == 0
    said = mistake("train", SECOND, "--resume", str(packed / "full/seed1"), "--agent.max-iterations", "3")
    assert "holds the actor alone" in said
    assert read_provenance(packed / "stage1/seed1/model_1.pt").total_steps == 128


def test_mistakes_are_said_in_one_sentence(folder: Path, mistake: Callable[..., str]) -> None:
    def said(before: str, after: str, *options: str) -> str:
        (folder / "bad.toml").write_text(TINY.replace(before, after))
        return mistake("campaign", "bad.toml", *options)

    assert "does not exist" in mistake("campaign", "nothing.toml")
    assert "give one of them" in mistake("campaign", "tiny.toml", "--dry-run", "--pack", "packed")
    assert "--jobs must be 1 or more" in mistake("campaign", "tiny.toml", "--jobs", "0")
    assert "is the folder of the campaign itself" in mistake("campaign", "tiny.toml", "--pack", "logs/tiny")
    assert f"train.full: task '{SECOND}x' does not exist; did you mean" in said(SECOND, SECOND + "x")
    assert "train.stage1: Unrecognized options: --env.num-env" in said("--env.num-envs", "--env.num-env")
    assert "train.stage1: Error parsing --env.num-envs: invalid literal" in said("num-envs 16", "num-envs x")
    assert "train.stage1: env.num_envs is 0" in said("num-envs 16", "num-envs 0")
    assert "evaluate.track: course 'held-out-track': grade 60" in said("grades = [20]", "grades = [60]")
    assert "evaluate.ramps: Unrecognized options: --second" in said("--seconds 1", "--second 1")
    changed = said("--env.num-envs 16", "--env.num-envs 8", "--out", "logs/tiny")
    assert "was begun with --env.num-envs 16" in changed


def test_a_job_that_fails_is_named_and_ends_with_exit_code_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    humoslope = Humoslope()
    humoslope.fails = {"calibrate"}
    monkeypatch.setattr(queue, "launch", humoslope)
    (tmp_path / "tiny.toml").write_text(TINY)
    assert main(["campaign", str(tmp_path / "tiny.toml"), "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr()
    assert "failed: stage1/seed1 calibration: exit code 2: it cannot walk." in told.out
    assert "barred: full/seed1 training: stage1/seed1 calibration failed" in told.out
    assert told.err == ("humoslope: 1 of 8 jobs failed, and 3 need their results; the same command tries them again.\n")


# The campaigns of experiments/

PLANS = sorted(path.name for path in EXPERIMENTS.glob("*.toml"))


@pytest.fixture(scope="module")
def plans(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Plan]:
    return {name: plan_of(EXPERIMENTS / name, Path("logs") / name.removesuffix(".toml")) for name in PLANS}


def test_every_campaign_of_experiments_can_be_run(plans: dict[str, Plan]) -> None:
    assert PLANS == ["crouch.toml", "recipe.toml", "reproduce.toml", "table2.toml", "table2_gpu.toml"]
    counts = {name: sum(job.verb == "train" for job in plan.jobs.values()) for name, plan in plans.items()}
    assert counts == {
        "crouch.toml": 5,
        "recipe.toml": 10,
        "reproduce.toml": 4,
        "table2.toml": 21,
        "table2_gpu.toml": 40,
    }


def test_table_2_has_equal_budgets_and_the_seeds_that_carry_it(plans: dict[str, Plan]) -> None:
    jobs = [job for job in plans["table2.toml"].jobs.values() if job.verb == "train"]
    budgets = {(job.row, job.scale.samples * job.iterations // 10**6) for job in jobs}
    first = {("stage1", 30), ("stage1-no-zmp", 30), ("horizontal-zmp", 30)}
    assert {pair for pair in budgets if pair[1] == 30} == first
    assert {budget for _, budget in budgets - first} == {20}
    seeds = {row: sum(job.row == row for job in jobs) for row in {job.row for job in jobs}}
    assert seeds == {
        **dict.fromkeys(("stage1", "full", "no-bsga", "no-zmp", "stage1-no-zmp"), 3),
        **dict.fromkeys(("no-critic-cue", "no-reward-priors", "horizontal-zmp"), 2),
    }
    assert len({job.words[0] for job in jobs}) == 8


def test_the_recipe_halves_every_reward_of_today_and_changes_one_thing_a_row(plans: dict[str, Plan]) -> None:
    text = tomllib.loads((EXPERIMENTS / "recipe.toml").read_text())["train"]["half-rewards"]["options"]
    halved = dict(zip(text.split()[::2], map(float, text.split()[1::2]), strict=True))
    today = {f"--env.rewards.{n.replace('_', '-')}.weight": t.weight for n, t in build_task(FIRST).env.rewards.items()}
    assert halved == pytest.approx({name: weight / 2.0 for name, weight in today.items()})
    words = {(" ".join(job.words[3:-4])) for job in plans["recipe.toml"].jobs.values()}
    assert len(words) == 9


def test_the_baselines_learn_as_stage_1_does_from_its_first_walk(plans: dict[str, Plan]) -> None:
    agents = {}
    for row in ("stage1", "url", "unitree-mjlab"):
        job = plans["reproduce.toml"].jobs[f"{row}/seed1 training"]
        task, *options = job.words
        cfg, args = parse(TrainArgs(), task, [*options, "--preset", "cpu"])
        agents[row] = cfg.agent
        assert args.init == ("" if row == "stage1" else "logs/reproduce/stage1/seed1/model_100.pt")
    assert agents["url"].critic_warmup_iterations > 0
    assert agents["url"] == agents["unitree-mjlab"]
    assert replace(agents["url"], critic_warmup_iterations=0) == agents["stage1"]


def test_make_goes_through_the_campaigns_and_writes_their_tables() -> None:
    text = (ROOT / "Makefile").read_text()
    for name in ("reproduce", "recipe"):
        assert f"humoslope campaign experiments/{name}.toml $(ARGS)" in text
