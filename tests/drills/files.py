"""One whole file of every kind that is read again, made as users make them, or by what writes them for users."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from humoslope.cli import main
from humoslope.deploy.gait import Gait
from humoslope.deploy.player import Trial
from humoslope.evaluation.margins.trials import TrialStore
from humoslope.evaluation.report.curve import PANELS, STEPS, write_table
from humoslope.evaluation.swing.file import write_calibration
from humoslope.evaluation.swing.fit import Bin, SwingFit
from humoslope.learning.run_folder import record_start
from humoslope.registry import build_task
from humoslope.slope.swing import SwingCalibration
from tests.drills.processes import TASK, train


class Made:
    """Files of all kinds below a folder, each made when it is first asked for.

    Args:
        actor: A checkpoint of a trained policy.
        exported: Its export folder, if there is one already.
    """

    def __init__(self, folder: Path, actor: Path, exported: Path | None = None) -> None:
        self._folder, self._actor, self._exported = folder, actor, exported
        self._made: dict[str, Path] = {}

    def __call__(self, kind: str) -> Path:
        """The file of a kind, or the folder."""
        if kind not in self._made:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._made[kind] = KINDS[kind](self)
        return self._made[kind]

    def checkpoint(self) -> Path:
        """A trained policy."""
        return self._actor

    def episodes(self) -> Path:
        """The state of the episodes of a tiny run."""
        assert train(self._folder / "run", 1) == 0
        return self._folder / "run" / "episodes_0.pt"

    def rollout(self) -> Path:
        """A short walk."""
        path = self._folder / "walk.npz"
        walk = ["--terrain", "ramp-up", "--grade", "5", "--seconds", "0.2", "--out", str(path)]
        assert main(["record", str(self._actor), *walk]) == 0
        return path

    def result(self) -> Path:
        """The result of an evaluation."""
        out = self._folder / "walked"
        walk = ["--grades", "0", "--trials", "1", "--parallel-trials", "1", "--timeout-s", "0.1", "--out", str(out)]
        assert main(["evaluate", str(self._actor), *walk]) == 0
        return self._folder / "walked.json"

    def saved_trials(self) -> Path:
        """The trials behind the result."""
        self("result")
        (path,) = self._folder.glob("walked.*.npz")
        return path

    def calibration(self) -> Path:
        """A calibration that was never measured."""
        path, bins = self._folder / "a.swing.json", (Bin(0.0, 700, 0.001, 0.51, True),)
        found = SwingFit(SwingCalibration(0.5, 0.8, 0.5), 0.01, 0.02, bins, (0.01,), 0.01)
        write_calibration(path, found, {"checkpoint": {"path": "model_7.pt", "sha256": 64 * "0"}})
        return path

    def saved_margins(self) -> Path:
        """Trials of a certificate that were never run."""
        path = self._folder / "margins.trials.json"
        store, gait = TrialStore(path, "fingerprint"), Gait(0.0, 0.3, 0.5, 0.1)
        for i in range(20):
            store.add(("load", 2.0 * i, 0), Trial(False, 20.0, 10.0, 0.5, 10.0, 0.5, 3.0, 0.0, 0.5, 0.0, gait))
        store.save()
        return path

    def curve(self) -> Path:
        """The table of a learning curve."""
        path = self._folder / "curve.csv"
        write_table({tag: {i: i / 7 for i in range(50)} for tag in (STEPS, *(p.tag for p in PANELS))}, path)
        return path

    def start(self) -> Path:
        """The record of a start."""
        run = self._folder / "started"
        record_start(run, TASK, build_task(TASK), ["--preset", "cpu", "--env.num-envs", "8"], 0, 0, None)
        return run

    def export(self) -> Path:
        """An export folder."""
        if self._exported is None:
            self._exported = self._folder / "export"
            assert main(["export", str(self._actor), "--out", str(self._exported)]) == 0
        return self._exported


KINDS: dict[str, Callable[[Made], Path]] = {
    "checkpoint": Made.checkpoint,
    "episodes": Made.episodes,
    "rollout": Made.rollout,
    "result": Made.result,
    "saved trials": Made.saved_trials,
    "calibration": Made.calibration,
    "saved margins": Made.saved_margins,
    "curve": Made.curve,
    "start": Made.start,
    "export": Made.export,
}
"""What makes each kind."""
