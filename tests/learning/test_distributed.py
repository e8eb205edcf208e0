"""Several processes train one policy: they log and save once, stop together, and draw different random numbers."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
import torch.distributed as dist

from humoslope.errors import UserError
from humoslope.evaluation.report.curve import read_curves
from humoslope.learning import checkpoint
from humoslope.learning.distributed import Processes, any_process, choose_device, mean_over_processes, read_processes
from tests import processes

PATIENCE_S = 600.0
"""Time after which the test gives up on its child processes; no result depends on it."""


def torchrun(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc_per_node=2", "-m", "humoslope"]
    return subprocess.Popen(
        [*command, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )


def ranks(*arguments: str) -> list[processes.Running]:
    """Two processes with the environment variables that torchrun would give them."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    common = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port}
    return [processes.start(*arguments, env=common | {"RANK": rank, "LOCAL_RANK": rank}) for rank in ("0", "1")]


def workers(agent: subprocess.Popen[str]) -> list[int]:
    """Process ids of the ranks, in their order."""
    children = Path(f"/proc/{agent.pid}/task/{agent.pid}/children").read_text().split()
    ranks = {}
    for child in children:
        found = re.search(rb"\0RANK=(\d)", Path(f"/proc/{child}/environ").read_bytes())
        if found:
            ranks[int(found[1])] = int(child)
    return [ranks[rank] for rank in sorted(ranks)]


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="finds the ranks by Linux's /proc")
def test_two_processes_log_once_save_once_stop_together_and_resume(task, tiny, tmp_path):
    run = tmp_path / "run"
    agent = torchrun("train", task, "--run-dir", str(run), *tiny, "--agent.max-iterations", "1000000")
    try:
        deadline = time.monotonic() + PATIENCE_S
        while not (run / "model_1.pt").exists():
            assert agent.poll() is None, agent.communicate()[0]
            assert time.monotonic() < deadline
            time.sleep(0.05)
        os.kill(workers(agent)[1], signal.SIGINT)  # only the second one hears of it
        said, _ = agent.communicate(timeout=PATIENCE_S)
    finally:
        agent.kill()
        agent.wait()
    assert agent.returncode != 0, said  # not complete
    last = checkpoint.latest(run)
    done = checkpoint.load(last, task)["iteration"] + 1
    assert said.count(f"Stopped after iteration {done}; saved {last}.") == 1
    assert said.count("humoslope: interrupted.") == 1
    assert len(list(run.glob("events.out.tfevents.*"))) == 1
    assert list(read_curves(run)["Perf/total_steps"].items()) == [(i, 64.0 * (i + 1)) for i in range(done)]
    assert len(list((run / "starts").iterdir())) == 1

    resumed = ranks("train", task, "--resume", str(run), "--agent.max-iterations", str(done + 2))
    for ended in [rank.wait(PATIENCE_S) for rank in resumed]:
        assert ended.returncode == 0, ended
    assert checkpoint.load(run / f"model_{done + 1}.pt", task)["total_steps"] == 64 * (done + 2)
    assert not list(tmp_path.glob("model_*.pt"))


def test_every_rank_resumes_with_random_numbers_of_its_own(on_shared_env, finished, monkeypatch):
    drawn = []
    for rank in range(3):
        trainer = on_shared_env(processes=Processes(rank, rank, 3))
        monkeypatch.setattr(trainer.env.cfg, "seed", trainer.cfg.env.seed + rank)  # as that of a rank's envs is
        for number in (1, 2):
            trainer.resume(finished / f"model_{number}.pt")
            drawn.append(tuple(torch.rand(4).tolist()))
    assert len(set(drawn)) == 6
    state = checkpoint.load(finished / "model_2.pt")["rng"]["torch"]
    on_shared_env(processes=Processes()).resume(finished / "model_2.pt")
    assert torch.equal(torch.get_rng_state(), state)


def test_steps_of_all_processes_are_counted(on_shared_env):
    trainer = on_shared_env(processes=Processes(0, 0, 3))
    trainer.iterate()
    assert trainer.total_steps == 3 * 32


def test_torchruns_variables_are_read_and_checked(monkeypatch):
    for name in ("RANK", "LOCAL_RANK", "WORLD_SIZE"):
        monkeypatch.delenv(name, raising=False)
    assert read_processes() == Processes(0, 0, 1)
    monkeypatch.setenv("RANK", "3")
    monkeypatch.setenv("LOCAL_RANK", "1")
    monkeypatch.setenv("WORLD_SIZE", "4")
    assert read_processes() == Processes(3, 1, 4)
    monkeypatch.setenv("WORLD_SIZE", "3")
    with pytest.raises(UserError, match="RANK 3, LOCAL_RANK 1 and WORLD_SIZE 3 do not go together"):
        read_processes()
    monkeypatch.setenv("WORLD_SIZE", "many")
    with pytest.raises(UserError, match="must be whole numbers"):
        read_processes()


def test_each_process_takes_the_gpu_of_its_local_rank_if_there_is_one(monkeypatch):
    chosen: list[int] = []
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "set_device", chosen.append)
    assert choose_device("auto", "auto", Processes(3, 1, 4)) == "cuda:1"
    assert choose_device("cpu", "auto", Processes(3, 1, 4)) == "cpu"
    assert choose_device("auto", "native", Processes(3, 1, 4)) == "auto"
    assert choose_device("auto", "auto", Processes()) == "auto"
    assert chosen == [1]
    with pytest.raises(UserError, match="process 2 of this machine has no GPU of its own: there are 2"):
        choose_device("auto", "auto", Processes(2, 2, 4))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert choose_device("auto", "auto", Processes(3, 1, 4)) == "auto"


def test_a_single_process_agrees_with_itself():
    assert any_process((True, False), torch.device("cpu")) == (True, False)
    assert torch.equal(mean_over_processes(torch.tensor(3.0)), torch.tensor(3.0))


@pytest.fixture
def three_processes(monkeypatch):
    """A group of three, whose two others have these values to be summed, and these flags."""
    others = {dist.ReduceOp.SUM: torch.tensor([4.0, 10.0]), dist.ReduceOp.MAX: torch.tensor([0.0, 1.0])}

    def all_reduce(values, op):
        both = torch.add if op == dist.ReduceOp.SUM else torch.maximum
        values.copy_(both(values, others[op]))

    monkeypatch.setattr(dist, "is_initialized", lambda: True)
    monkeypatch.setattr(dist, "get_world_size", lambda: 3)
    monkeypatch.setattr(dist, "all_reduce", all_reduce)


@pytest.mark.usefixtures("three_processes")
def test_processes_share_the_mean_of_a_value_and_any_flag():
    own = torch.tensor([2.0, -1.0])
    assert mean_over_processes(own).tolist() == [2.0, 3.0]
    assert own.tolist() == [2.0, -1.0]
    assert any_process((True, False), torch.device("cpu")) == (True, True)
    assert any_process((False, False), torch.device("cpu")) == (False, True)


def test_physics_warnings_of_every_process_are_heard(on_shared_env, monkeypatch, capsys):
    trainer = on_shared_env(processes=Processes(1, 1, 2))
    monkeypatch.setattr(trainer.env.sim, "warnings", lambda: ["the contact buffer is full"])
    trainer._report_physics({})
    assert capsys.readouterr().err == "process 1, physics: the contact buffer is full\n"
