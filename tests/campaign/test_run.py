"""A campaign runs what is left of it, by what lies on disk alone."""

from __future__ import annotations

import fcntl
import itertools
import json
import os
import signal
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO

import pytest

from humoslope.campaign import disk
from humoslope.campaign import run as queue
from humoslope.campaign.cost import Estimate
from humoslope.campaign.run import Run, run
from humoslope.errors import UserError
from tests.campaign.campaigns import SMALL, Ended, Humoslope, leave_run, plan, read


@pytest.fixture
def humoslope() -> Humoslope:
    return Humoslope()


def finish(folder: Path, humoslope: Humoslope, text: str = SMALL, jobs: int = 1) -> Run:
    """Runs the small campaign to its end."""
    state = Run(plan(folder, text))
    assert run(state, jobs, 1, start=humoslope) == 0
    return state


def verbs(humoslope: Humoslope) -> list[str]:
    return [words[0] for words in humoslope.ran]


def test_everything_is_run_once_and_each_job_finds_what_it_reads(tmp_path: Path, humoslope: Humoslope) -> None:
    state = finish(tmp_path, humoslope)
    assert set(state.states.values()) == {"done"}
    assert verbs(humoslope) == ["train", "calibrate", "evaluate", "ramps", "train", "evaluate"] * 2
    finish(tmp_path, humoslope)
    assert len(humoslope.ran) == 12
    assert (tmp_path / "out" / "log" / "full-seed2-track.txt").is_file()


def test_jobs_get_their_share_of_threads(tmp_path: Path, humoslope: Humoslope) -> None:
    assert run(Run(plan(tmp_path)), 2, 3, start=humoslope) == 0
    assert {(env["OMP_NUM_THREADS"], env["HUMOSLOPE_THREADS"]) for env in humoslope.env} == {("3", "3")}


def test_a_training_goes_on_from_its_newest_checkpoint(tmp_path: Path, humoslope: Humoslope) -> None:
    made = plan(tmp_path)
    job = made.jobs["stage1/seed1 training"]
    leave_run(job.folder, ["train", *job.words])
    (job.folder / "model_4.pt").touch()
    disk.check_begun(made)
    assert disk.progress(job, running=False).iterations == 5
    finish(tmp_path, humoslope)
    assert humoslope.ran[0] == ["train", job.words[0], "--resume", str(job.folder), "--agent.max-iterations", "10"]


def test_a_training_that_left_no_checkpoint_begins_anew(tmp_path: Path, humoslope: Humoslope) -> None:
    job = plan(tmp_path).jobs["stage1/seed1 training"]
    leave_run(job.folder, ["train", *job.words])
    (job.folder / "console.log").touch()
    assert set(finish(tmp_path, humoslope).states.values()) == {"done"}


@pytest.mark.parametrize("name", ["ramps.json", "notes.md", "stage1.swing.json"])
def test_results_without_a_checkpoint_are_not_removed(tmp_path: Path, humoslope: Humoslope, name: str) -> None:
    job = plan(tmp_path).jobs["stage1/seed1 training"]
    leave_run(job.folder, ["train", *job.words])
    (job.folder / name).write_text("precious")
    run = finish(tmp_path, humoslope)
    assert "holds no checkpoint, but other files; move them" in run.reasons[job.name]
    assert {name for name, state in run.states.items() if state == "failed"} == {job.name}
    assert (job.folder / name).read_text() == "precious"


def test_a_run_folder_that_is_in_use_is_not_removed(tmp_path: Path) -> None:
    job = plan(tmp_path).jobs["stage1/seed1 training"]
    job.folder.mkdir(parents=True)
    handle = os.open(job.folder, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        assert disk.in_use(job.folder)
        disk.clear_abandoned(job.folder)
        assert job.folder.is_dir()
    finally:
        os.close(handle)
    assert not disk.in_use(job.folder)


@contextmanager
def holding(folder: Path) -> Iterator[None]:
    """Keeps a run folder, as a training does."""
    folder.mkdir(parents=True)
    handle = os.open(folder, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        yield
    finally:
        os.close(handle)


def test_others_run_while_a_folder_is_held_and_it_is_taken_when_it_is_free(
    tmp_path: Path, humoslope: Humoslope
) -> None:
    made, events = plan(tmp_path), []
    first, last = made.jobs["stage1/seed1 training"], "full/seed2 track"  # of all that does not need the first one
    with ExitStack() as stack:
        stack.enter_context(holding(first.folder))

        def show(event: str) -> None:
            events.append(event)
            if event == f"done: {last}":
                stack.close()

        state = Run(made)
        assert run(state, 1, 1, show, humoslope) == 0
    assert set(state.states.values()) == {"done"}
    assert events.index(f"begins: {last}") < events.index(f"begins: {first.name}")


def test_a_folder_that_stays_held_is_left_to_the_training_to_complain_of(tmp_path: Path, humoslope: Humoslope) -> None:
    made = plan(tmp_path)
    first, times = made.jobs["stage1/seed1 training"], itertools.count(0.0, 7.0)
    humoslope.fails.add(str(first.folder))
    state = Run(made)
    with holding(first.folder):
        run(state, 1, 1, start=humoslope, clock=lambda: next(times))
    assert ["train", *first.words] in humoslope.ran
    assert state.reasons[first.name] == "exit code 2: it cannot walk."


def test_a_campaign_that_waits_for_a_folder_hears_a_signal(tmp_path: Path, humoslope: Humoslope) -> None:
    made = plan(tmp_path, SMALL.replace("seeds = [1, 2]", "seeds = [1]"))
    looks = itertools.count()

    def show(event: str) -> None:
        if next(looks) == 2:
            os.kill(os.getpid(), signal.SIGTERM)

    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with holding(made.jobs["stage1/seed1 training"].folder):
            assert run(Run(made), 1, 1, show, humoslope) == signal.SIGTERM
    finally:
        signal.signal(signal.SIGTERM, before)
    assert humoslope.ran == []


@pytest.mark.parametrize("damage", ["{", "[]", '{"checkpoints": []}', ""])
def test_a_damaged_result_is_made_anew(tmp_path: Path, humoslope: Humoslope, damage: str) -> None:
    finish(tmp_path, humoslope)
    track = plan(tmp_path).jobs["full/seed1 track"].result
    track.write_text(damage)
    finish(tmp_path, humoslope)
    assert len(humoslope.ran) == 13


def test_results_of_other_trials_or_checkpoints_and_partial_ones_are_made_anew(
    tmp_path: Path, humoslope: Humoslope
) -> None:
    finish(tmp_path, humoslope)
    finish(tmp_path, humoslope, SMALL.replace("trials = 4", "trials = 5"))
    assert verbs(humoslope)[12:] == ["evaluate"] * 4
    finish(tmp_path, humoslope, SMALL.replace("trials = 4", "trials = 5").replace("steps = 700", "steps = 800"))
    assert verbs(humoslope)[16:] == ["train", "evaluate"] * 2
    assert "--resume" in humoslope.ran[16]
    result = plan(tmp_path).jobs["stage1/seed1 track"].result
    report = json.loads(result.read_text())
    result.write_text(json.dumps(report | {"partial": True}))
    assert not disk.is_done(plan(tmp_path, SMALL.replace("trials = 4", "trials = 5")).jobs["stage1/seed1 track"])


def test_a_folder_may_move_to_another_machine(tmp_path: Path, humoslope: Humoslope) -> None:
    finish(tmp_path, humoslope)
    (tmp_path / "there").mkdir()
    (tmp_path / "out").rename(tmp_path / "there" / "out")
    made = plan(tmp_path / "there")
    disk.check_begun(made)
    assert set(Run(made).states.values()) == {"done"}


def test_a_failure_bars_what_needs_it_and_nothing_else(tmp_path: Path, humoslope: Humoslope) -> None:
    humoslope.fails = {"stage1/seed1"}
    state = finish(tmp_path, humoslope)
    failed = {name: reason for name, reason in state.reasons.items() if state.states[name] == "failed"}
    assert failed == {"stage1/seed1 training": "exit code 2: it cannot walk."}
    assert state.count("barred") == 5
    assert state.count("done") == 6
    # What failed is tried again.
    humoslope.fails = set()
    assert set(finish(tmp_path, humoslope).states.values()) == {"done"}


def test_a_failed_calibration_bars_only_the_next_stage(tmp_path: Path, humoslope: Humoslope) -> None:
    humoslope.fails = {"calibrate"}
    state = finish(tmp_path, humoslope)
    assert {name for name, of in state.states.items() if of == "barred"} == {
        f"full/seed{seed} {column}" for seed in (1, 2) for column in ("training", "track")
    }


def test_an_end_without_result_and_a_kill_are_failures(tmp_path: Path) -> None:
    codes = iter([0, -9])
    state = Run(plan(tmp_path))
    assert run(state, 1, 1, start=lambda words, env, log: Ended(next(codes))) == 0
    first, second = (state.reasons[f"stage1/seed{seed} training"] for seed in (1, 2))
    assert first.startswith("exit code 0: it ended without an error but left no '")
    assert second == "exit code -9: killed by SIGKILL"


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("--env.num-envs 16", "--env.num-envs 8", "begun with --env.num-envs 16"),
        ("--env.num-envs 16", "", "begun with --env.num-envs 16"),
        ("--env.num-envs 16", "--env.num-envs 16 --agent.gamma 0.9", "begun with the default of --agent.gamma"),
        ("iterations = 10", "iterations = 4", "has 10 iterations, more than 4"),
        ('"stage1"\nsteps', '"other"\nsteps', "begun with parent "),
    ],
)
def test_a_table_does_not_mix_options(tmp_path: Path, humoslope: Humoslope, before: str, after: str, said: str) -> None:
    text = SMALL + SMALL[SMALL.index("[train.stage1]") : SMALL.index("[evaluate.track]")].replace("stage1", "other")
    finish(tmp_path, humoslope, text)
    disk.check_begun(plan(tmp_path, text))
    with pytest.raises(UserError) as caught:
        disk.check_begun(plan(tmp_path, text.replace(before, after)))
    assert said in str(caught.value)
    assert "choose another folder with --out." in str(caught.value)


def test_videos_of_a_training_may_be_asked_for_later(tmp_path: Path, humoslope: Humoslope) -> None:
    finish(tmp_path, humoslope)
    disk.check_begun(plan(tmp_path, SMALL.replace("--env.num-envs 16", "--env.num-envs 16 --video-every 50")))


def test_what_a_calibration_has_set_is_no_change(tmp_path: Path, humoslope: Humoslope) -> None:
    finish(tmp_path, humoslope)
    made = plan(tmp_path)
    options = made.jobs["full/seed1 training"].folder / "starts" / "1" / "options.txt"
    options.write_text(options.read_text() + " --env.rewards.swing-hip.params.beta0 0.5")
    disk.check_begun(made)
    options.write_text(options.read_text() + " --env.rewards.swing-hip.weight 2")
    with pytest.raises(UserError, match=r"begun with --env\.rewards\.swing-hip\.weight 2"):
        disk.check_begun(made)
    options.write_text(f"--preset gpu {options.read_text().split(' --env.rewards.swing-hip.weight')[0]}")
    options.write_text(options.read_text().replace("--preset cpu", ""))
    with pytest.raises(UserError, match=r"begun with --preset gpu"):
        disk.check_begun(made)


def test_the_scale_of_what_has_begun_is_kept_on_any_machine(tmp_path: Path, humoslope: Humoslope) -> None:
    auto = SMALL.replace('preset = "cpu"', 'preset = "auto"')
    assert disk.settled(read(tmp_path, auto), tmp_path / "out").preset == "auto"
    finish(tmp_path, humoslope, SMALL.replace('preset = "cpu"', 'preset = "gpu"'))
    assert disk.settled(read(tmp_path, auto), tmp_path / "out").preset == "gpu"
    assert disk.settled(read(tmp_path), tmp_path / "out").preset == "cpu"


def test_one_campaign_at_a_time_has_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    with disk.held(folder), pytest.raises(UserError, match="is in use by another campaign"), disk.held(folder):
        pass
    assert not folder.exists()
    folder.touch()
    with pytest.raises(UserError, match="cannot be made"), disk.held(folder):
        pass


def test_what_is_left_is_estimated_from_what_was_measured(tmp_path: Path, humoslope: Humoslope) -> None:
    state = Run(plan(tmp_path))
    unknown = Estimate(state).of(state.plan.jobs.values())
    assert unknown.seconds is None
    assert unknown.steps == 2 * (640 + 704)
    given = Estimate(state, speed=100.0).of(state.plan.jobs.values())
    # Six evaluations of 1000 steps at 37 % of a training's speed; calibrations are not known.
    assert given.seconds == pytest.approx(2 * 1344 / 100.0 + 6 * 1000 / 37.0)
    humoslope.fails = {"full/seed2"}
    state = finish(tmp_path, humoslope)
    left = Estimate(state)
    assert left.speed == 2000.0
    whole = left.of(state.plan.jobs.values())
    assert (whole.steps, whole.seconds) == (704, pytest.approx(704 / 2000.0 + 30.0))
    assert whole.bytes == pytest.approx(4 * 1000 + 24e3 * 16)


# Processes


WALKER = """
import signal, sys, time
from pathlib import Path

def stop(number, frame):
    Path(sys.argv[1], "model_4.pt").touch()
    sys.exit(128 + number)

for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, stop)
Path(sys.argv[1], "begun").touch()
time.sleep(60)
"""


@pytest.fixture
def walker(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Real processes take the place of trainings, and save when they are stopped; returns a file to be imported."""
    child = tmp_path / "child.py"
    child.write_text(WALKER)
    return child


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_passed_on_and_what_was_saved_is_gone_on_with(
    tmp_path: Path, walker: Path, number: signal.Signals
) -> None:
    import subprocess

    made = plan(tmp_path)
    folders = [made.jobs[f"stage1/seed{seed} training"].folder for seed in (1, 2)]

    def start(words: list[str], env: Mapping[str, str], log: IO[bytes]) -> subprocess.Popen[bytes]:
        folder = Path(words[words.index("--run-dir") + 1])
        leave_run(folder, words)
        command = [sys.executable, "-IS", str(walker), str(folder)]
        return subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)

    sent = False

    def show(event: str) -> None:
        nonlocal sent
        if not sent and all((folder / "begun").exists() for folder in folders):
            sent = True
            os.kill(os.getpid(), number)

    before = signal.signal(number, signal.default_int_handler)
    try:
        state = Run(made)
        assert run(state, 2, 1, show, start) == number
    finally:
        signal.signal(number, before)
    assert state.count("waiting") == len(made.jobs)
    assert not state.reasons
    assert all((folder / "model_4.pt").exists() for folder in folders)
    assert disk.command(made.jobs["stage1/seed1 training"])[2:4] == ["--resume", str(folders[0])]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Linux alone tells a child of its parent's death")
def test_a_job_is_stopped_when_the_campaign_is_killed(tmp_path: Path) -> None:
    import subprocess

    child = tmp_path / "child.py"
    child.write_text(
        "import os, signal, sys, time\n"
        "from humoslope.interrupts import stop_with_parent\n"
        "from pathlib import Path\n"
        "def stop(number, frame):\n    Path('saved').touch(); sys.exit(0)\n"
        "signal.signal(signal.SIGTERM, stop)\n"
        "stop_with_parent(int(sys.argv[1]), signal.SIGTERM)\n"
        "Path('begun').touch()\n"
        "time.sleep(60)\n"
    )
    parent = (
        "import os, subprocess, sys, time\n"
        "from pathlib import Path\n"
        "subprocess.Popen([sys.executable, 'child.py', str(os.getpid())], start_new_session=True)\n"
        "while not Path('begun').exists(): time.sleep(0.02)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run([sys.executable, "-c", parent], cwd=tmp_path, env=env, check=False)
    assert done.returncode == -9
    for _ in range(500):
        if (tmp_path / "saved").exists():
            return
        import time

        time.sleep(0.02)
    raise AssertionError("the child was not stopped")


def test_a_job_is_a_process_of_its_own_with_its_share_of_threads(tmp_path: Path) -> None:
    with (tmp_path / "log").open("wb") as log:
        process = queue.launch(["nonsense"], {"HUMOSLOPE_THREADS": "1"}, log)
        assert process.wait() == 2
    assert queue._said(tmp_path / "log").startswith("verb 'nonsense' does not exist")


def test_the_words_of_a_failure_are_the_last_that_were_said(tmp_path: Path) -> None:
    (tmp_path / "log").write_text("humoslope: first.\nmore\nhumoslope: second.\n")
    assert queue._said(tmp_path / "log") == "second."
    assert queue._said(tmp_path / "nothing") == ""
