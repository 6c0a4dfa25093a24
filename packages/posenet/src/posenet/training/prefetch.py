"""Items made ahead of their use by other processes, for a consumer faster than one core makes them.

Not by threads: those share one interpreter lock, and whoever drives a GPU lets go of it at every answer he waits for
and then stands in line behind all that make items. An H200 took 220 ms for steps of 20 ms so.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Generic, TypeVar

import torch

from evalkit.errors import InputError
from posenet.training.interruption import leave_to_the_parent

Item = TypeVar("Item")

_make: Callable[[int], Any]  # in a process that makes items


class Prefetch(Generic[Item]):
    """`make(number)` for numbers that are asked for in order, the next `ahead` of them in the making meanwhile.

    `make` and the items travel between processes, so both must be picklable; arrays of numpy are, in little time.
    """

    def __init__(self, make: Callable[[int], Item], ahead: int, workers: int) -> None:
        self._ahead = ahead
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([__name__, make.__module__])
        self._executor = ProcessPoolExecutor(workers, context, initializer=_begin, initargs=(make,))
        self._coming: dict[int, Future[Item]] = {}

    def __getitem__(self, number: int) -> Item:
        """What `make` returns, or raises, for `number`.

        Raises:
            InputError: a process that makes items was killed.
        """
        wanted = range(number, number + self._ahead + 1)
        for unwanted in self._coming.keys() - set(wanted):
            self._coming.pop(unwanted).cancel()
        try:
            for one in wanted:
                if one not in self._coming:
                    self._coming[one] = self._executor.submit(_made, one)
            return self._coming.pop(number).result()
        except BrokenProcessPool:
            raise InputError(
                "a process that reads training images was killed, perhaps for want of memory; the last checkpoint is "
                "kept: run the same command again to resume."
            ) from None

    def close(self) -> None:
        """Drop what nobody asked for, and end the processes."""
        self._executor.shutdown(wait=False, cancel_futures=True)


def _begin(make: Callable[[int], Any]) -> None:
    """The first thing that each process does."""
    global _make
    _make = make
    leave_to_the_parent()
    torch.set_num_threads(1)


def _made(number: int) -> Any:
    return _make(number)
