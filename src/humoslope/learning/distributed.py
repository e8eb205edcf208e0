"""Several processes that train one policy: one for each GPU, or for each share of a CPU, as torchrun starts them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
import torch.distributed as dist

from humoslope.errors import UserError


@dataclass(frozen=True)
class Processes:
    """This process among those of a run.

    Attributes:
        rank: Number of this process among all; the first one logs and saves.
        local_rank: Number of this process on its machine.
        size: Number of processes.
    """

    rank: int = 0
    local_rank: int = 0
    size: int = 1

    @property
    def is_first(self) -> bool:
        """True in the process that logs and saves."""
        return self.rank == 0


def read_processes() -> Processes:
    """The processes that torchrun has started, by its environment variables; a single one without it.

    Raises:
        UserError: If the variables contradict each other.
    """
    names = {"rank": "RANK", "local_rank": "LOCAL_RANK", "size": "WORLD_SIZE"}
    try:
        processes = Processes(**{field: int(os.environ[name]) for field, name in names.items() if name in os.environ})
    except ValueError as error:
        raise UserError(f"{', '.join(names.values())} must be whole numbers, as torchrun sets them: {error}.") from None
    if not 0 <= processes.local_rank <= processes.rank < processes.size:
        raise UserError(
            f"RANK {processes.rank}, LOCAL_RANK {processes.local_rank} and WORLD_SIZE {processes.size} do not go "
            "together; start the processes with torchrun."
        )
    return processes


def choose_device(configured: str, backend: str, processes: Processes) -> str:
    """The device of this process: with several processes each takes the GPU of its local rank, unless the CPU or the
    native physics, which has no other device, was asked for.

    Raises:
        UserError: If there are fewer GPUs than processes on this machine.
    """
    wants_gpu = configured in ("auto", "cuda") and backend != "native"
    if processes.size == 1 or not wants_gpu or not torch.cuda.is_available():
        return configured
    if processes.local_rank >= torch.cuda.device_count():
        raise UserError(
            f"process {processes.local_rank} of this machine has no GPU of its own: there are "
            f"{torch.cuda.device_count()}; start as many processes with torchrun --nproc_per_node."
        )
    torch.cuda.set_device(processes.local_rank)
    return f"cuda:{processes.local_rank}"


@contextmanager
def process_group(processes: Processes, device: str) -> Iterator[None]:
    """Connects the processes while inside: by nccl between GPUs, by gloo between CPUs. A single one needs nothing."""
    if processes.size == 1:
        yield
        return
    dist.init_process_group(
        "nccl" if device.startswith("cuda") else "gloo", rank=processes.rank, world_size=processes.size
    )
    try:
        yield
    finally:
        dist.destroy_process_group()


def any_process(flags: tuple[bool, ...], device: torch.device) -> tuple[bool, ...]:
    """The flags that are set in at least one process. Waits for the others."""
    if not dist.is_initialized():
        return flags
    values = torch.tensor(flags, dtype=torch.float32, device=device)
    dist.all_reduce(values, op=dist.ReduceOp.MAX)
    return tuple(bool(value) for value in values.tolist())


def wait_for_all(device: torch.device) -> None:
    """Returns once every process has come here."""
    any_process((False,), device)


def mean_over_processes(value: torch.Tensor) -> torch.Tensor:
    """The mean of a tensor over all processes; the tensor itself in a single one."""
    if not dist.is_initialized():
        return value
    total = value.clone()
    dist.all_reduce(total, op=dist.ReduceOp.SUM)
    return total / dist.get_world_size()
