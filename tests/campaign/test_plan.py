"""A plan has a job for everything that a campaign wants, each after those whose results it reads."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humoslope.campaign.plan import make_plan
from humoslope.errors import UserError
from tests.campaign.campaigns import FIRST, SECOND, SMALL, plan, read, scale


def test_every_seed_is_trained_calibrated_and_evaluated_and_the_first_seed_first(tmp_path: Path) -> None:
    assert list(plan(tmp_path).jobs) == [
        f"{row}/seed{seed} {column}"
        for seed in (1, 2)
        for row, column in (
            ("stage1", "training"),
            ("stage1", "calibration"),
            ("stage1", "track"),
            ("stage1", "ramps"),
            ("full", "training"),
            ("full", "track"),
        )
    ]


def test_a_training_is_the_command_that_a_user_would_type(tmp_path: Path) -> None:
    jobs, out = plan(tmp_path).jobs, tmp_path / "out"
    full = jobs["full/seed2 training"]
    assert full.iterations == 11  # 700 steps at 64 in an iteration
    assert full.steps == 704
    assert full.result == out / "full" / "seed2" / "model_10.pt"
    assert full.needs == ("stage1/seed2 calibration",)
    assert " ".join(full.words) == (
        f"{SECOND} --run-dir {out}/full/seed2 --preset cpu --env.num-envs 16 --env.seed 2 --agent.max-iterations 11 "
        f"--init {out}/stage1/seed2/model_9.pt"
    )
    calibration = jobs["stage1/seed2 calibration"]
    # Where the training looks for it by itself.
    assert calibration.result == full.parent.with_suffix(".swing.json")
    assert " ".join(calibration.words) == f"{full.parent} --out {calibration.result} --starts 2"
    track, ramps = jobs["full/seed2 track"], jobs["stage1/seed2 ramps"]
    assert " ".join(track.words) == f"{full.result} --out {out}/full/seed2/track --grades 20 --trials 4"
    assert (track.verb, track.result) == ("evaluate", out / "full" / "seed2" / "track.json")
    assert " ".join(ramps.words) == f"{full.parent} --out {out}/stage1/seed2/ramps.json --starts 8"
    assert (ramps.verb, ramps.result) == ("ramps", out / "stage1" / "seed2" / "ramps.json")


def test_a_calibration_that_nobody_needs_is_not_made(tmp_path: Path) -> None:
    text = SMALL.replace("steps = 700", 'steps = 700\ncalibration = "prior"')
    jobs = plan(tmp_path, text).jobs
    assert not any("calibration" in name for name in jobs)
    assert jobs["full/seed1 training"].words[-2:] == ("--calibration", "prior")
    assert jobs["full/seed1 training"].needs == ("stage1/seed1 training",)


def test_a_calibration_is_made_for_the_seeds_of_the_next_stage_alone(tmp_path: Path) -> None:
    jobs = plan(tmp_path, SMALL.replace("steps = 700", "steps = 700\nseeds = [2]")).jobs
    assert [name for name in jobs if "calibration" in name] == ["stage1/seed2 calibration"]


def test_an_earlier_checkpoint_of_a_parent_can_be_the_start(tmp_path: Path) -> None:
    text = SMALL.replace("steps = 700", f'steps = 700\nparent-iteration = 5\ncalibration = "{Path(__file__)}"')
    words = plan(tmp_path, text).jobs["full/seed1 training"].words
    assert f"{tmp_path}/out/stage1/seed1/model_5.pt" in words


@settings(max_examples=15)
@given(counts=st.lists(st.integers(0, 6), min_size=1, max_size=7), seeds=st.integers(1, 3))
def test_every_job_comes_after_those_it_needs(
    tmp_path_factory: pytest.TempPathFactory, counts: list[int], seeds: int
) -> None:
    # Row i starts from row counts[i], if that is an earlier one; rows are listed backwards.
    rows = [
        f'[train.r{i}]\ntask = "{FIRST}"\niterations = 3\n' + (f'parent = "r{parent}"\n' if parent < i else "")
        for i, parent in enumerate(counts)
    ]
    text = f"seeds = {list(range(seeds))}\n{''.join(reversed(rows))}[evaluate.e]\nkind = 'sweep'\n"
    made = plan(tmp_path_factory.mktemp("plan"), text)
    assert len(made.jobs) == 2 * seeds * len(counts)
    done: set[str] = set()
    for name, job in made.jobs.items():
        assert set(job.needs) <= done
        done.add(name)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (SMALL.replace(FIRST, "Walk"), "train.stage1: task 'Walk' does not exist."),
        (SMALL.replace("--env.num-envs 16", "--bad"), "train.full: Unrecognized options: --bad."),
        (SMALL.replace('parent = "stage1"', ""), f"train.full needs a 'parent' that trains {FIRST}, or a checkpoint"),
        (SMALL.replace('parent = "stage1"', 'parent = "file.pt"'), "train.full.parent has no swing calibration"),
        (
            SMALL.replace(FIRST, SECOND).replace(
                "iterations = 10", "iterations = 10\nparent = 'file.pt'\ncalibration = 'prior'"
            ),
            f"train.full.parent is 'stage1', which trains {SECOND}; {SECOND} starts from {FIRST}",
        ),
        (
            SMALL.replace("iterations = 10", "iterations = 10\ncalibration = 'prior'"),
            "train.stage1.calibration has no effect",
        ),
        (SMALL.replace("steps = 700", "steps = 700\nparent-iteration = 3"), "has a checkpoint every 5 iterations"),
        (SMALL.replace("steps = 700", "steps = 700\nparent-iteration = 10"), "from 0 on, and at 9"),
        (SMALL.replace("steps = 700", "steps = 700\nparent-iteration = 5"), "needs a 'calibration': only a parent's"),
    ],
)
def test_what_the_tasks_do_not_allow_is_said_with_its_key(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "file.pt").touch()
    with pytest.raises(UserError) as caught:
        plan(tmp_path, text)
    assert said in str(caught.value)
    assert str(caught.value).startswith(f"campaign '{tmp_path / 'small.toml'}': ")


def test_options_of_an_evaluation_are_looked_at_before_anything_runs(tmp_path: Path) -> None:
    def refuse(evaluation: object) -> int:
        raise UserError("no such grade.")

    with pytest.raises(UserError, match=r"evaluate\.track: no such grade\.$"):
        make_plan(read(tmp_path), tmp_path / "out", scale, refuse)
