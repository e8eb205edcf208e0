"""The check of an installation: each check finds the fault it is there for, and the report and exit code follow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from humoslope.check import learning, machine, physics
from humoslope.check.finding import Finding
from humoslope.check.host_sync import check_host_sync
from humoslope.cli import check, main
from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.learning.benchmark import Measurement
from humoslope.registry import TaskCfg, build_task
from humoslope.seal import read_json
from humoslope.sim.warp import WarpSimulation

TASK = "HumoSlope-Stage1-Unitree-G1"
RIGHT, WRONG = Finding("sense", "1", "1"), Finding("sense", "0", "1", right=False)


def env_cfg(num_envs: int, **sim: object) -> EnvCfg:
    cfg = build_task(TASK).env
    return replace(cfg, num_envs=num_envs, sim=replace(cfg.sim, **{"device": "cpu", "num_threads": 1, **sim}))


def wrong(findings: list[Finding]) -> list[str]:
    return [finding.subject for finding in findings if not finding.right]


def test_the_report_holds_every_finding_and_what_is_right_exits_with_0(monkeypatch, tmp_path, capsys) -> None:
    monkeypatch.setattr(check, "checks", lambda *_: [("one", lambda: [RIGHT]), ("two", lambda: [RIGHT, RIGHT])])
    out = tmp_path / "check.json"
    assert main(["check", TASK, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "all right" in printed
    assert "WRONG" not in printed
    assert '"sha256": "' in out.read_text()
    report = read_json(out)
    assert report["right"] is True
    assert [len(group) for group in report["checks"].values()] == [1, 2]


def test_what_is_wrong_exits_with_1_and_the_other_checks_still_run(monkeypatch, tmp_path, capsys) -> None:
    def stops() -> list[Finding]:
        raise RuntimeError("CUDA error 700")

    monkeypatch.setattr(check, "checks", lambda *_: [("a", stops), ("b", lambda: [WRONG]), ("c", lambda: [RIGHT])])
    out = tmp_path / "check.json"
    with pytest.raises(SystemExit) as exit_:
        main(["check", TASK, "--out", str(out)])
    assert exit_.value.code == 1
    assert "2 wrong" in capsys.readouterr().out
    assert '"sha256": "' in out.read_text()
    report = read_json(out)
    assert report["right"] is False
    assert "CUDA error 700" in report["checks"]["a"][0]["measured"]
    assert report["checks"]["c"][0]["right"] is True


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ([], "check needs a task"),
        ([TASK, "--checkpoint", "none.pt"], "none.pt"),
        ([TASK, "--curve", "none.csv"], "curve 'none.csv' cannot be read"),
        ([TASK, "--curve", __file__], "is not a curve with Train/reward"),
        ([TASK, "--env.sim.device", "cuda:7"], "cuda:7"),
    ],
)
def test_a_mistake_is_one_sentence(typed: list[str], message: str, capsys) -> None:
    assert main(["check", *typed]) == 2
    assert message in capsys.readouterr().err


def test_the_checks_cover_what_the_help_promises() -> None:
    names = [
        name
        for name, _ in check.checks(
            TASK, build_task(TASK), torch.device("cpu"), check.SCALES["cpu", True], None, None, []
        )
    ]
    assert names == ["machine", "contacts", "motion", "graphs", "random actions", "host syncs", "speed", "training"]


def test_a_gpu_that_torch_cannot_use_is_found(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr(machine, "NVIDIA_DRIVER", tmp_path / "version")
    assert wrong(machine.describe_machine(torch.device("cpu"))) == []
    (tmp_path / "version").touch()
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.version, "cuda", None)
    (finding,) = [f for f in machine.describe_machine(torch.device("cpu")) if not f.right]
    assert "there is an NVIDIA driver, but torch is installed without CUDA" in finding.measured


def test_contacts_and_motion_are_right_here_and_a_kick_is_found(monkeypatch) -> None:
    cfg = env_cfg(1)
    assert wrong(physics.check_contacts("cpu") + physics.check_motion(cfg, "cpu")) == []
    step = WarpSimulation.step

    def kick(self: WarpSimulation, n: int, mask: torch.Tensor | None = None) -> None:
        step(self, n, mask)
        self.state("qvel")[-1, 0] += 2.0  # as of a contact with a wrong depth, m/s
        self.state("qpos")[-1, -1] += 0.1

    monkeypatch.setattr(WarpSimulation, "step", kick)
    assert len(wrong(physics.check_contacts("cpu"))) == 4
    (found,) = wrong(physics.check_motion(cfg, "cpu"))
    assert "farthest tiles" in found


def test_graphs_are_right_here_and_a_stale_one_is_found(monkeypatch) -> None:
    cfg = env_cfg(1)
    assert set(wrong(physics.check_graphs(cfg, "cpu"))) <= {"captured step, of a direct one"}  # busy machines differ
    tile = WarpSimulation._tile

    def keep(self: WarpSimulation, struct: object, field: str) -> None:
        graphs = dict(self._graphs)
        tile(self, struct, field)
        self._graphs.update(graphs)

    monkeypatch.setattr(WarpSimulation, "_tile", keep)
    assert "captured and direct run apart" in wrong(physics.check_graphs(cfg, "cpu"))


def test_a_full_buffer_is_found_under_random_actions() -> None:
    right = physics.check_rollout(ManagerBasedRlEnv(env_cfg(4, backend="warp")), 2)
    assert wrong(right) == []
    found = wrong(physics.check_rollout(ManagerBasedRlEnv(env_cfg(4, backend="warp", nconmax=1)), 2))
    assert len(found) == 1
    assert "full buffers" in found[0]


def test_a_host_sync_is_found_and_the_environment_left_as_it_was() -> None:
    env = ManagerBasedRlEnv(env_cfg(4, backend="native"))
    assert wrong(check_host_sync(env, 2)) == []
    env.observers.append(lambda env: env.signals.joint_vel.sum().item())
    (finding,) = check_host_sync(env, 2)
    assert not finding.right
    assert "wait" in finding.measured or "copies" in finding.measured
    assert "step" not in vars(env.sim)


@pytest.mark.parametrize(("share", "found"), [(0.9, []), (0.1, ["8 envs, env.step of raw", "8 envs, training of raw"])])
def test_a_slow_environment_is_found(monkeypatch, share: float, found: list[str]) -> None:
    def measured(task: str, cfg: TaskCfg, rounds: int) -> Measurement:
        raw = 1000.0 * cfg.env.num_envs
        slow = [share * raw] * rounds
        return Measurement(cfg.env.num_envs, [raw] * rounds, slow, slow, [1.0], [1.0], [1.0], 1.0, {}, "Card", 900.0)

    monkeypatch.setattr(learning, "measure", measured)
    findings, results = learning.check_speed(TASK, build_task(TASK), (4, 8), 2)
    assert wrong(findings) == found
    assert [result.num_envs for result in results] == [4, 8]
    assert "card 900 MiB" in findings[0].measured


@pytest.mark.parametrize(("reward", "found"), [(1.0, 0), (50.0, 1)])
def test_a_training_below_its_curve_is_found(
    tmp_path: Path, stage1_checkpoint: Path, reward: float, found: int
) -> None:
    curve = tmp_path / "curve.csv"
    curve.write_text("iteration,Train/reward,Train/falls_per_second\n1,0,9\n" + f"2,{reward},0.5\n" * 100)
    cfg = build_task(TASK)
    cfg = replace(cfg, env=env_cfg(16, backend="native"))
    findings = learning.check_training(TASK, cfg, 4, stage1_checkpoint, curve)
    assert len(wrong(findings)) == found
    assert "62.7" in findings[0].subject, "it goes on from the checkpoint's samples"


def test_a_curve_without_the_checkpoint_that_goes_on_from_it_is_refused(tmp_path: Path, capsys) -> None:
    curve = tmp_path / "curve.csv"
    curve.write_text("iteration,Train/reward,Train/falls_per_second\n1,0,9\n")
    assert main(["check", TASK, "--curve", str(curve)]) == 2
    assert "--curve is what a run from --checkpoint is compared with" in capsys.readouterr().err
