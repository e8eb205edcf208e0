"""What comes with HumoSlope beside its code: tasks, terrains, robots, and the results of trainings.

In a checkout these are its top-level folders. A wheel has the same folders inside of this package, in `content/`, so
that it puts no packages of such general names beside those of others; `setup.py` copies them there.
"""

from __future__ import annotations

import sys
import traceback
from importlib import import_module
from pathlib import Path

from humoslope.errors import UserError
from humoslope.plugins import import_all

HERE = Path(__file__).parent
PACKAGES = ("robots", "terrains", "tasks")
"""Folders of Python files, each after those that it imports."""
STAGE1, STAGE2 = (Path(f"experiments/checkpoints/{stage}.pt") for stage in ("stage1", "stage2"))
EXPORT = Path("experiments/exports/stage2")
ROLLOUT = Path("experiments/rollouts/stage2_track20.npz")
FILES = {
    STAGE1: "Checkpoint of Stage I, with its swing calibration.",
    STAGE2: "Checkpoint of Stage II.",
    EXPORT: "Its export, which `humoslope demo` shows.",
    ROLLOUT: "Its walk on the held-out track.",
}
"""What a user may name on the command line, by its path in a checkout."""


def root() -> Path:
    """The folder that holds `tasks`, `terrains`, `robots` and `experiments`."""
    bundled = HERE / "content"
    return bundled if bundled.is_dir() else HERE.parents[1]


def found(path: Path) -> Path:
    """`path`; or, where nothing has that name, what comes with HumoSlope and has it in a checkout."""
    shipped = root() / path
    return shipped if not path.is_absolute() and not path.exists() and shipped.exists() else path


def load() -> None:
    """Imports all robots, terrains and tasks: those that come with HumoSlope, and those in folders of these names in
    the working folder, as modules of the same packages.

    Raises:
        UserError: If the working folder has another module of a name that is taken, or one that cannot be imported.
    """
    home = root()
    if not (home / "tasks" / "__init__.py").is_file():
        return
    if str(home) not in sys.path:
        sys.path.insert(0, str(home))
    packages = [import_module(name) for name in PACKAGES]
    own = [Path.cwd() / name for name in PACKAGES]
    for package, folder in zip(packages, own, strict=True):
        if str(folder) not in package.__path__ and folder.is_dir() and not folder.samefile(home / package.__name__):
            _check_names(home / package.__name__, folder)
            package.__path__.append(str(folder))
    for package, folder in zip(packages, own, strict=True):
        import_all(package.__name__, [path for path in package.__path__ if path != str(folder)])
    for package, folder in zip(packages, own, strict=True):
        if str(folder) not in package.__path__:
            continue
        try:
            import_all(package.__name__, [str(folder)])
        except (Exception, SystemExit) as error:  # whatever a file does that may have nothing to do with HumoSlope
            if isinstance(error, UserError) or folder.parent == home:
                raise
            raise UserError(_unfit(folder, error)) from error


def _unfit(own: Path, error: BaseException) -> str:
    """What went wrong in a file of the working folder, and where."""
    inside = [frame for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename).parent == own]
    where = f"'{own.name}/{Path(inside[-1].filename).name}', line {inside[-1].lineno}" if inside else f"'{own.name}'"
    return (
        f"{where}: {type(error).__name__}: {error}; every file in that folder is imported, so that it can register "
        "something. If the folder has nothing to do with HumoSlope, work in another one."
    )


def _check_names(shipped: Path, own: Path) -> None:
    """Raises UserError if a module of the working folder would be hidden by one of the same name."""
    for path in sorted(own.glob("*.py")):
        taken = shipped / path.name
        if path.name != "__init__.py" and taken.is_file() and taken.read_bytes() != path.read_bytes():
            raise UserError(
                f"'{own.name}/{path.name}' has the name of a file that comes with HumoSlope; give it another name, or, "
                "if this folder is a checkout, install that: pip install -e ."
            )
