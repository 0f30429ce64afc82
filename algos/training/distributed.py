"""Training of one policy in several processes started by ``torchrun``, each with its own environments."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
import torch.distributed as dist

from warpvox.errors import ConfigError, DeviceError

Value = TypeVar("Value")


@dataclass(frozen=True)
class ProcessGroup:
    """Processes that train one policy together, and this process's rank.

    ``rank`` is the index of this process among all ``size`` processes, ``local_rank`` its index among the
    ``local_size`` on this machine. The processes exchange tensors on ``device``. In a group of one process no method
    communicates.
    """

    rank: int = 0
    size: int = 1
    local_rank: int = 0
    local_size: int = 1
    device: str = "cpu"

    @property
    def is_main_process(self) -> bool:
        """True for the process that writes files, evaluates and reports."""
        return self.rank == 0

    def seed(self, seed: int) -> int:
        """Derive this process's seed from ``seed``; the first process uses ``seed`` itself."""
        if self.is_main_process:
            return seed
        return int(np.random.SeedSequence([seed, self.rank]).generate_state(1, np.uint32)[0])

    def sum(self, values: Sequence[float]) -> list[float]:
        """Sum each value over all processes."""
        if self.size == 1:
            return list(values)
        # NCCL has float64, some other devices have not; here it is CUDA or the CPU
        total = torch.tensor(values, dtype=torch.float64, device=self.device)
        dist.all_reduce(total)
        return total.tolist()

    def any(self, flag: bool) -> bool:
        return bool(self.sum([float(flag)])[0])

    def broadcast(self, value: Value) -> Value:
        """Return the ``value`` passed by the first process, in all processes."""
        if self.size == 1:
            return value
        box = [value]
        dist.broadcast_object_list(box, src=0, device=torch.device(self.device))
        return box[0]


SINGLE_PROCESS = ProcessGroup()


def join_process_group(device: str) -> ProcessGroup:
    """Join the processes started by ``torchrun``; otherwise return a group of one.

    Args:
        device: ``cuda`` and ``auto`` become this process's own GPU; the processes talk by NCCL then, else by gloo.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        return SINGLE_PROCESS
    names = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "LOCAL_WORLD_SIZE")
    rank, size, local_rank, local_size = (int(os.environ[name]) for name in names)
    if device.startswith("cuda:"):
        raise ConfigError(f"Under torchrun every process takes a GPU of its own: device=cuda, not {device}.")
    own = "cpu"
    if device == "cuda" or (device == "auto" and torch.cuda.is_available()):
        if local_size > torch.cuda.device_count():
            raise DeviceError(
                f"{local_size} processes need as many GPUs; this machine has {torch.cuda.device_count()}."
            )
        own = f"cuda:{local_rank}"
        torch.cuda.set_device(local_rank)
    if not dist.is_initialized():
        dist.init_process_group("gloo" if own == "cpu" else "nccl", rank=rank, world_size=size)
    return ProcessGroup(rank, size, local_rank, local_size, own)
