"""What comes beside the code is found from any folder, and what a user has there is added to it."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import pytest

from humoslope import shipped
from humoslope.cli.measure import subject
from humoslope.deploy import contract as contracts
from humoslope.errors import UserError
from tests import processes

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "experiments" / "examples"


def test_what_lies_in_the_folder_comes_before_what_is_shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert shipped.found(shipped.STAGE2) == ROOT / shipped.STAGE2
    assert shipped.found(tmp_path / shipped.STAGE2) == tmp_path / shipped.STAGE2
    assert shipped.found(Path("no/such.pt")) == Path("no/such.pt")
    own = tmp_path / shipped.STAGE2
    own.parent.mkdir(parents=True)
    own.touch()
    assert shipped.found(shipped.STAGE2) == shipped.STAGE2


def test_results_beside_the_name_of_a_shipped_export_do_not_hide_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / shipped.EXPORT).mkdir(parents=True)
    (tmp_path / shipped.EXPORT / "margins.json").touch()
    assert contracts.located(shipped.EXPORT) == ROOT / shipped.EXPORT
    measured = subject(shipped.EXPORT)
    assert measured.provenance.task == "HumoSlope-Stage2-Unitree-G1"
    assert measured.beside("heldout") == shipped.EXPORT / "heldout"


def test_all_that_a_user_may_name_exists() -> None:
    for path in shipped.FILES:
        assert (ROOT / path).exists()


def test_the_shipped_export_is_that_of_the_shipped_checkpoint() -> None:
    training = contracts.read(ROOT / shipped.EXPORT).training
    digest = sha256((ROOT / shipped.STAGE2).read_bytes()).hexdigest()
    assert training.sha256 == digest, f"run `humoslope export {shipped.STAGE2} --out {shipped.EXPORT}`"


def test_tasks_and_terrains_of_the_working_folder_are_added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for kind in ("tasks", "terrains"):
        (tmp_path / kind).mkdir()
        (tmp_path / kind / "gravel.py").write_bytes((EXAMPLES / kind / "gravel.py").read_bytes())
    monkeypatch.chdir(tmp_path)
    listed = processes.run("list", path=(ROOT / "src",))
    assert listed.returncode == 0, listed.stderr
    for name in ("gravel-ramp", "HumoSlope-Gravel-Unitree-G1", "HumoSlope-Stage2-Unitree-G1", str(shipped.EXPORT)):
        assert name in listed.stdout
    (tmp_path / "tasks" / "stage1.py").write_text("")
    listed = processes.run("list", path=(ROOT / "src",))
    assert listed.returncode == 2
    assert listed.stderr.startswith("humoslope: 'tasks/stage1.py' has the name of a file that comes with HumoSlope;")


@pytest.mark.parametrize("wrong", ["import celery_that_is_not_there", "raise RuntimeError('no broker')", "exit(3)"])
def test_a_folder_of_tasks_that_are_no_tasks_is_named_with_the_line_that_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wrong: str
) -> None:
    (tmp_path / "tasks").mkdir()
    (tmp_path / "tasks" / "mail.py").write_text(f"sent = 0\n{wrong}\n")
    monkeypatch.chdir(tmp_path)
    listed = processes.run("list", path=(ROOT / "src",))
    assert listed.returncode == 2
    assert listed.stderr.startswith("humoslope: 'tasks/mail.py', line 2: ")
    assert "work in another one" in listed.stderr
    assert "Traceback" not in listed.stderr


def test_a_copy_of_a_shipped_file_is_no_second_one(tmp_path: Path) -> None:
    own = tmp_path / "tasks"
    own.mkdir()
    (own / "stage1.py").write_bytes((ROOT / "tasks" / "stage1.py").read_bytes())
    (own / "__init__.py").write_text("")
    shipped._check_names(ROOT / "tasks", own)
    (own / "stage1.py").write_text("changed = True\n")
    with pytest.raises(UserError, match="give it another name"):
        shipped._check_names(ROOT / "tasks", own)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, unpacked into an empty folder."""
    source, folder = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "setup.py", "README.md"):
        shutil.copy(ROOT / name, source)
    for name in ("src", "tasks", "terrains", "robots"):  # what is built must leave no trace in the checkout
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    (source / "experiments").symlink_to(ROOT / "experiments")
    build = "from setuptools.build_meta import build_wheel; print(build_wheel('.'))"
    done = subprocess.run([sys.executable, "-c", build], cwd=source, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (built,) = source.glob("*.whl")
    assert built.stat().st_size < 20e6
    subprocess.run([sys.executable, "-m", "zipfile", "-e", str(built), str(folder)], check=True)
    return folder


def test_the_wheel_puts_one_package_beside_those_of_others(wheel: Path) -> None:
    names = {path.name for path in wheel.iterdir() if not path.name.endswith(".dist-info")}
    assert names == {"humoslope"}
    for path in shipped.FILES:
        assert (wheel / "humoslope" / "content" / path).exists()


def test_the_wheel_trains_and_evaluates_in_an_empty_folder(
    wheel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    def humoslope(*arguments: str) -> str:
        done = processes.run(*arguments, path=(wheel,))
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert str(shipped.STAGE1) in humoslope("list")
    tiny = ["--preset", "cpu", "--env.num-envs", "4", "--env.sim.device", "cpu", "--env.scene.terrain.levels", "2"]
    tiny += ["--env.scene.terrain.num-columns", "8", "--agent.num-steps-per-env", "4", "--agent.max-iterations", "1"]
    said = humoslope("train", "HumoSlope-Stage2-Unitree-G1", *tiny)
    assert str(wheel / "humoslope" / "content" / shipped.STAGE1) in said
    (model,) = (tmp_path / "logs" / "HumoSlope-Stage2-Unitree-G1").glob("*/model_0.pt")
    assert "commit " in (model.parent / "starts" / "1" / "git.txt").read_text()
    short = ["--grades", "10", "--tiers", "0.6", "--trials", "1", "--timeout-s", "0.4"]
    humoslope("evaluate", str(shipped.STAGE2), *short, "--out", "result")
    assert json.loads((tmp_path / "result.json").read_text())["checkpoints"]
    played = humoslope("play", str(shipped.EXPORT), "--headless", "--seconds", "0.5")
    assert "No fall in 0.5 s." in played
