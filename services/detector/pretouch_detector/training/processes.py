"""The processes that teach one network together, as torchrun starts them; alone, there is one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

# Before any group exists: its functions keep the group of the moment as their default, and a group that is kept
# has threads that end with the interpreter, in a race that the process may lose (SIGABRT).
import torch.distributed.nn
from torch import distributed, nn


@dataclass(frozen=True)
class Processes:
    """Attributes: rank: this process, from 0. world: how many there are."""

    rank: int
    world: int

    def share_gradients(self, model: nn.Module) -> None:
        """The mean over all processes; a loss may call a model's parts by themselves, which DDP would not see."""
        if self.world == 1:
            return
        for parameter in model.parameters():
            if parameter.grad is None:
                parameter.grad = torch.zeros_like(parameter)
            distributed.all_reduce(parameter.grad)
            parameter.grad /= self.world


ALONE = Processes(0, 1)


@contextmanager
def join_processes(device: torch.device) -> Iterator[Processes]:
    """All of them, as the environment tells, joined until the block ends well; with CUDA each takes a GPU of its own.

    A block that fails leaves the others alone: parting waits for all, and torchrun ends them.
    """
    rank, world = int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
    if world == 1:
        yield ALONE
        return
    if device.type == "cuda":
        torch.cuda.set_device(int(os.environ["LOCAL_RANK"]))
    distributed.init_process_group("nccl" if device.type == "cuda" else "gloo")
    yield Processes(rank, world)
    distributed.destroy_process_group()
