"""One of the processes that train together: its share of every batch, and what all of them sum and agree on."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import torch
from lightning_fabric import Fabric
from lightning_fabric.loggers import Logger
from lightning_fabric.plugins.environments import ClusterEnvironment
from lightning_fabric.strategies import DDPStrategy
from torch import Tensor, distributed

from posenet.layers.mean import Mean

PATIENCE = timedelta(hours=6)  # the others wait so long while the leader validates and saves


@dataclass(frozen=True)
class Rank:
    """Which of `size` processes this one is, and the port (on this machine) where they meet."""

    index: int = 0
    size: int = 1
    port: int = 0

    @property
    def leads(self) -> bool:
        return self.index == 0

    @property
    def title(self) -> str:
        return f"process {self.index + 1} of {self.size}"

    def fabric(self, device: torch.device, logger: Logger | None) -> Fabric:
        """Fabric for this process's device, joined with the other processes."""
        logging.getLogger("lightning_fabric").setLevel(logging.WARNING)  # it greets, and wants geometry in TF32 on GPUs
        if self.size == 1:
            return Fabric(accelerator=device.type, devices=1, loggers=logger)
        backend = "nccl" if device.type == "cuda" else "gloo"
        strategy = DDPStrategy(process_group_backend=backend, timeout=PATIENCE)
        fabric = Fabric(
            accelerator=device.type, devices=self.size, strategy=strategy, plugins=[_Here(self)], loggers=logger
        )
        fabric.launch()
        return fabric

    def share(self, items: Any) -> Any:
        """This process's share of a batch, dealt like cards: images first in the batch are first somewhere."""
        return items[self.index :: self.size]

    def summed(self, losses: dict[str, Mean]) -> dict[str, Mean]:
        """Sums and counts over all processes, without gradient; all must have losses of the same names."""
        names = sorted(losses)
        values = torch.stack([part.detach().double() for name in names for part in losses[name]])
        self._all_reduce(values)
        pairs = values.float().view(-1, 2)
        return {name: Mean(*pair) for name, pair in zip(names, pairs, strict=True)}

    def from_leader(self, value: float, device: torch.device) -> float:
        """The leader's `value`, in every process."""
        if self.size == 1:
            return value
        shared = torch.tensor([value], dtype=torch.float64, device=device)
        distributed.broadcast(shared, 0)
        return float(shared)

    def _all_reduce(self, values: Tensor) -> None:
        if self.size > 1:
            distributed.all_reduce(values)


ALONE = Rank()


class _Here(ClusterEnvironment):  # type: ignore[misc]
    """Processes of one machine that exist already, for Fabric."""

    def __init__(self, rank: Rank) -> None:
        self.rank = rank

    @property
    def creates_processes_externally(self) -> bool:
        return True

    @property
    def main_address(self) -> str:
        return "127.0.0.1"

    @property
    def main_port(self) -> int:
        return self.rank.port

    @staticmethod
    def detect() -> bool:
        return False

    def world_size(self) -> int:
        return self.rank.size

    def set_world_size(self, size: int) -> None: ...

    def global_rank(self) -> int:
        return self.rank.index

    def set_global_rank(self, rank: int) -> None: ...

    def local_rank(self) -> int:
        return self.rank.index

    def node_rank(self) -> int:
        return 0
