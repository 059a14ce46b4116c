"""The processes that train one network together, as torchrun starts them; without torchrun there is one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

# Imported before any process group exists: its functions keep the group that exists at import as a default argument,
# and the threads of a group that is kept alive may crash the interpreter as it exits (SIGABRT).
import torch.distributed.nn
from torch import distributed, nn


@dataclass(frozen=True)
class Processes:
    """Attributes: rank: this process, from 0. world: how many there are."""

    rank: int
    world: int

    def share_gradients(self, model: nn.Module) -> None:
        """Averages the gradients over all processes; DDP would miss parts of the model that the loss calls directly."""
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
    """The process group that the environment describes, left as the block ends; with CUDA each process has its own GPU.

    A block that fails does not leave the group, which would wait for all processes: torchrun ends them.
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
