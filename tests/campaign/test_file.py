"""A campaign's file is read whole, and every mistake in it gets one sentence with the key."""

from __future__ import annotations

from pathlib import Path

import pytest

from humoslope.campaign.file import read_campaign
from humoslope.errors import UserError
from tests.campaign.campaigns import FIRST, SECOND, SMALL, read


def test_a_campaign_is_what_its_file_says(tmp_path: Path) -> None:
    campaign = read(tmp_path)
    assert (campaign.preset, campaign.calibrate) == ("cpu", ("--starts", "2"))
    assert list(campaign.trainings) == ["full", "stage1"]
    full = campaign.trainings["full"]
    assert (full.task, full.parent, full.steps, full.iterations, full.seeds) == (SECOND, "stage1", 700, 0, (1, 2))
    assert full.options == ("--env.num-envs", "16")
    track, ramps = campaign.evaluations["track"], campaign.evaluations["ramps"]
    assert (track.kind, track.of, track.words) == ("held-out", ("full", "stage1"), ("--grades", "20", "--trials", "4"))
    assert (ramps.kind, ramps.of, ramps.words) == ("ramps", ("stage1",), ("--starts", "8"))


def test_a_row_adds_its_options_to_those_of_the_file(tmp_path: Path) -> None:
    text = SMALL.replace("iterations = 10", "iterations = 10\nseeds = [2, 1, 7]\noptions = '''--a 1\n  --b \"2 3\"'''")
    row = read(tmp_path, text).trainings["stage1"]
    assert row.options == ("--env.num-envs", "16", "--a", "1", "--b", "2 3")
    assert row.seeds == (2, 1, 7)


def test_a_parent_may_be_a_file_beside_the_campaign(tmp_path: Path) -> None:
    (tmp_path / "walker.pt").touch()
    row = read(tmp_path, SMALL.replace('parent = "stage1"', 'parent = "walker.pt"')).trainings["full"]
    assert (row.parent, row.checkpoint) == ("", tmp_path / "walker.pt")


def test_a_sweep_is_an_evaluation_of_its_kind(tmp_path: Path) -> None:
    text = SMALL.replace('"held-out"', '"sweep"').replace("trials = 4", 'options = "--tiers 0.6"')
    assert read(tmp_path, text).evaluations["track"].words == ("--sweep", "--grades", "20", "--tiers", "0.6")


MISTAKES = [
    (SMALL + "[train", "is no TOML: "),
    ("seeds = [1]", "train has no row"),
    ("train = 3", "train must be tables, each under its name as [train.NAME]"),
    (SMALL.replace("preset", "preste"), "preste is unknown; did you mean 'preset'?"),
    (SMALL.replace('"cpu"', '"tpu"'), "preset is 'tpu'; it must be one of auto, cpu, gpu"),
    (SMALL.replace("steps", "stepz"), "train.full.stepz is unknown; did you mean 'steps'?"),
    (SMALL.replace("steps = 700", "steps = -1"), "train.full.steps is -1; it must be positive"),
    (SMALL.replace("steps = 700", "steps = nan"), "train.full.steps is nan; it must be positive"),
    (SMALL.replace("steps = 700", "steps = '700'"), "train.full.steps must be a number"),
    (SMALL.replace("iterations = 10", "iterations = 0"), "train.stage1.iterations is 0; it must be positive"),
    (SMALL.replace("iterations = 10", "iterations = 1.5"), "train.stage1.iterations must be a whole number"),
    (SMALL.replace("steps = 700", ""), "train.full needs either 'steps' or 'iterations'"),
    (SMALL.replace("steps = 700", "steps = 7\niterations = 1"), "train.full needs either 'steps' or 'iterations'"),
    (SMALL.replace(f'task = "{FIRST}"', ""), "train.stage1 needs 'task'"),
    (SMALL.replace(f'task = "{FIRST}"', "task = 3"), "train.stage1.task must be text in quotes"),
    (SMALL.replace('parent = "stage1"', 'parent = "stage2"'), "train.full.parent is 'stage2', which is neither a row"),
    (SMALL.replace('parent = "stage1"', 'parent = "a/b.pt"'), "train.full.parent is 'a/b.pt'; there is no file"),
    (SMALL.replace('parent = "stage1"', 'parent = "full"'), "train.full.parent goes round in a circle: full <- full"),
    (SMALL.replace("seeds = [1, 2]", "seeds = [1, 1]"), "seeds must be a list of whole numbers of at least 0, each"),
    (SMALL.replace("evaluate.track", "evaluate.training"), "evaluate.training cannot have this name, which something"),
    (SMALL.replace("evaluate.track", "evaluate.starts"), "evaluate.starts cannot have this name, which something"),
    (SMALL.replace("--env.num-envs 16", "--watch"), "options has --watch, which only a training that you start your"),
    (SMALL.replace("seeds = [1, 2]", "seeds = [-1]"), "seeds must be a list of whole numbers of at least 0, each"),
    (SMALL.replace("iterations = 10", "iterations = 10\nseeds = [1]"), "parent is 'stage1', which has no seed 2"),
    (SMALL.replace("--env.num-envs 16", "--env.seed 3"), "options has --env.seed, which 'seeds' sets"),
    (SMALL.replace("--env.num-envs 16", "--agent.max_iterations=3"), "which 'steps' or 'iterations' sets"),
    (SMALL.replace("--env.num-envs 16", "16"), "options begins with '16'; options begin with --"),
    (SMALL.replace("--env.num-envs 16", "--a 'b"), "options cannot be read: No closing quotation"),
    (SMALL.replace("steps = 700", "steps = 7\nparent-iteration = -2"), "train.full.parent-iteration must be 0 or more"),
    (SMALL.replace("steps = 700", "steps = 7\ncalibration = 'no'"), "train.full.calibration is 'no'; there is no file"),
    (SMALL.replace("train.full", "train.'f/l'"), "train.'f/l' is no name of letters"),
    (SMALL.replace('"held-out"', '"heldout"'), "evaluate.track.kind is 'heldout'; it must be one of held-out, sweep"),
    (SMALL.replace('["stage1"]', '["stage"]'), "evaluate.ramps.of names the row 'stage', which does not exist; did"),
    (SMALL.replace("grades = [20]", "grades = 20"), "evaluate.track.grades must be a list of numbers"),
    (SMALL.replace("trials = 4", "trials = 0"), "evaluate.track.trials is 0; it must be 1 or more"),
    (SMALL.replace("trials = 4", "options = '--out x'"), "evaluate.track.options has --out, which the campaign sets"),
]


@pytest.mark.parametrize(("text", "said"), MISTAKES, ids=[said[:40] for _, said in MISTAKES])
def test_a_mistake_is_said_in_one_sentence_with_its_key(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(UserError) as caught:
        read(tmp_path, text)
    sentence = str(caught.value)
    assert sentence.startswith(f"campaign '{tmp_path / 'small.toml'}'")
    assert said in sentence
    assert sentence.endswith((".", "?"))
    assert "\n" not in sentence


def test_a_longer_circle_is_named(tmp_path: Path) -> None:
    row = '[train.{}]\ntask = "a"\niterations = 1\nparent = "{}"\n'
    with pytest.raises(UserError, match=r"parent goes round in a circle: (a <- b <- c <- a|b <- c|c <- a)"):
        read(tmp_path, row.format("a", "c") + row.format("b", "a") + row.format("c", "b"))


def test_a_file_that_is_not_there_or_no_text_is_said(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"does not exist\.$"):
        read_campaign(tmp_path / "nothing.toml")
    with pytest.raises(UserError, match=r"cannot be read: "):
        read_campaign(tmp_path)
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(UserError, match=r"cannot be read: "):
        read_campaign(tmp_path / "b.toml")
