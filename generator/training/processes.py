"""Several processes that learn one model: each its share of every batch.

Plain ``torch.distributed``: the samples of a batch, their noise and their text drop-out are
functions of their number (:mod:`generator.training.draws`), so all that processes must agree on is
the mean of their gradients, which ``DistributedDataParallel`` takes. A framework around that would
be one more dependency that decides over devices, precision and files.

``torchrun`` starts the processes and tells each of them its place through the environment.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from datetime import timedelta

import torch
from torch import Tensor, distributed, nn

from robots.errors import SpecError

_PATIENCE = timedelta(hours=12)
"""How long processes wait for each other: the first one may have a dataset to prepare."""


@dataclass(frozen=True, slots=True)
class Processes:
    """Who learns together."""

    rank: int = 0
    """Number of this process."""
    world: int = 1
    """How many there are."""
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    """Where this process computes."""

    @property
    def leads(self) -> bool:
        """Whether this process writes files and speaks."""
        return self.rank == 0

    def shared(self, module: nn.Module) -> nn.Module:
        """Return a module whose gradients are the mean over all processes."""
        if self.world == 1:
            return module
        devices = [self.device] if self.device.type == "cuda" else None
        return nn.parallel.DistributedDataParallel(
            module, device_ids=devices, broadcast_buffers=False
        )

    def mean(self, value: Tensor) -> Tensor:
        """Return the mean of a tensor over all processes."""
        if self.world == 1:
            return value
        value = value.clone()
        distributed.all_reduce(value)
        return value / self.world

    def any(self, flag: bool) -> bool:
        """Return whether any process says so."""
        if self.world == 1:
            return flag
        votes = torch.tensor([float(flag)], device=self.device)
        distributed.all_reduce(votes)
        return bool(votes > 0)

    def wait(self) -> None:
        """Wait until all processes are here."""
        if self.world > 1:
            distributed.barrier()


def join(device: str = "auto") -> Processes:
    """Return the place of this process, as ``torchrun`` gave it; alone otherwise.

    Args:
        device: ``cpu``, ``cuda``, or ``auto`` for the latter if there is one.

    Raises:
        SpecError: There is no such device here, or the environment makes no sense.
    """
    if device not in ("auto", "cpu", "cuda"):
        raise SpecError(f"'{device}'", where="device", allowed="auto, cpu, cuda")
    if device == "cuda" and not torch.cuda.is_available():
        raise SpecError("there is no CUDA device here", where="device")
    on_gpu = torch.cuda.is_available() and device != "cpu"
    try:
        world = int(os.environ.get("WORLD_SIZE", "1"))
        rank, local = (int(os.environ.get(key, "0")) for key in ("RANK", "LOCAL_RANK"))
    except ValueError as error:
        raise SpecError(f"{error}", where="WORLD_SIZE, RANK, LOCAL_RANK") from error
    place = torch.device("cuda", local) if on_gpu else torch.device("cpu")
    if on_gpu:
        torch.cuda.set_device(place)
    if world > 1:
        try:
            distributed.init_process_group(
                "nccl" if on_gpu else "gloo", rank=rank, world_size=world, timeout=_PATIENCE
            )
        except (RuntimeError, ValueError) as error:
            raise SpecError(
                f"the {world} processes do not find each other: {str(error).splitlines()[0]}",
                where="MASTER_ADDR, MASTER_PORT",
                hint="start them with torchrun",
            ) from error
    return Processes(rank, world, place)


def leave(processes: Processes) -> None:
    """Take leave of the other processes."""
    if processes.world > 1 and distributed.is_initialized():
        distributed.destroy_process_group()
