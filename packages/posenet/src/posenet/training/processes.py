"""Several processes that train one network: each takes its share of every batch (DDP: gloo on CPUs, NCCL on GPUs).

The process that the user started leads: it alone writes, validates, draws and obeys signals. The others are started
by it, compute their share of each step, and end with it. They need nothing of their own on disk, so a run goes on from
the leader's checkpoint, on as many devices as it is then given.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from multiprocessing.connection import Connection
from typing import Any

import torch
from lightning_fabric import Fabric
from lightning_fabric.loggers import Logger
from lightning_fabric.plugins.environments import ClusterEnvironment
from lightning_fabric.strategies import DDPStrategy
from torch import Tensor, distributed

from evalkit.errors import InputError
from posenet.layers.mean import Mean

PATIENCE = timedelta(hours=6)  # the others wait so long while the leader validates and saves
READY = "ready"
LONGEST_FAREWELL = 10.0  # seconds that a process has to say why it ended


@dataclass(frozen=True)
class Rank:
    """Which of `size` processes this one is, and the port (on this machine) where they meet."""

    index: int = 0
    size: int = 1
    port: int = 0

    @property
    def leads(self) -> bool:
        return self.index == 0

    def fabric(self, device: torch.device, logger: Logger | None) -> Fabric:
        """Fabric for this process's device, joined with the other processes."""
        if self.size == 1:
            return Fabric(accelerator=device.type, devices=1, loggers=logger)
        logging.getLogger("lightning_fabric").setLevel(logging.WARNING)  # it greets
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


@contextmanager
def processes(size: int, work: Callable[[Rank], None]) -> Iterator[Rank]:
    """Within the block this process leads `size` processes, the others of which run `work`.

    Raises:
        InputError: one of the others met a user's mistake, or ended before the leader did.
    """
    if size == 1:
        yield ALONE
        return
    threads = torch.get_num_threads()
    others = [
        _Other(Rank(index, size, port), work, threads // size) for port in [_free_port()] for index in range(1, size)
    ]
    try:
        for other in others:
            other.wait_until_ready()
        torch.set_num_threads(max(1, threads // size))
        yield Rank(0, size, others[0].rank.port)
    except RuntimeError as error:  # what a collective raises when its peer is gone
        reason = next((reason for other in others if (reason := other.last_words())), None)
        raise InputError(reason) if reason else error from None
    finally:
        torch.set_num_threads(threads)
        for other in others:
            other.end()
        if distributed.is_initialized():
            distributed.destroy_process_group()


class _Other:
    """A process beside the leader, seen from the leader."""

    def __init__(self, rank: Rank, work: Callable[[Rank], None], threads: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.rank = rank
        self.inbox, outbox = context.Pipe(duplex=False)
        self.process = context.Process(target=_follow, args=(rank, work, max(1, threads), outbox), daemon=True)
        self.process.start()
        outbox.close()

    def wait_until_ready(self) -> None:
        reason = self._said()
        if reason != READY:
            raise InputError(reason or self._how_it_ended())

    def last_words(self) -> str | None:
        """Why it ended; None if it has not."""
        self.process.join(LONGEST_FAREWELL)
        if self.process.exitcode is None:
            return None
        return self._said() or self._how_it_ended()

    def end(self) -> None:
        self.process.kill()
        self.process.join()

    def _said(self) -> str | None:
        try:
            return str(self.inbox.recv_bytes().decode())
        except EOFError:
            return None

    def _how_it_ended(self) -> str:
        self.process.join(LONGEST_FAREWELL)
        code = self.process.exitcode
        how = f"was killed by signal {-code}" if code is not None and code < 0 else f"ended with code {code}"
        return (
            f"process {self.rank.index + 1} of {self.rank.size} {how}, so training stopped; the last checkpoint is "
            "kept: run the same command again to resume."
        )


def _follow(rank: Rank, work: Callable[[Rank], None], threads: int, outbox: Connection) -> None:
    """All that a process beside the leader does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes, and the leader decides
    torch.set_num_threads(threads)
    leader = os.getppid()
    outbox.send_bytes(READY.encode())
    try:
        work(rank)
    except (InputError, OSError) as error:
        _say(outbox, str(error))
    except RuntimeError as error:
        if os.getppid() == leader:
            _say(outbox, f"process {rank.index + 1} of {rank.size} failed: {error}")
    os._exit(0)  # without the farewells of a process group that may have lost its leader


def _say(outbox: Connection, words: str) -> None:
    with contextlib.suppress(OSError):
        outbox.send_bytes(words.encode())


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


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
