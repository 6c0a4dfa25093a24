"""Items made ahead of their use by threads, for a consumer faster than one core makes them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Prefetch(Generic[Item]):
    """`make(number)` for numbers that are asked for in order, the next `ahead` of them in the making meanwhile."""

    def __init__(self, make: Callable[[int], Item], ahead: int) -> None:
        self._make, self._ahead = make, ahead
        self._executor = ThreadPoolExecutor(max(1, ahead), thread_name_prefix="prefetch")
        self._coming: dict[int, Future[Item]] = {}

    def __getitem__(self, number: int) -> Item:
        """What `make` returns, or raises, for `number`."""
        wanted = range(number, number + self._ahead + 1)
        for unwanted in self._coming.keys() - set(wanted):
            self._coming.pop(unwanted).cancel()
        for one in wanted:
            if one not in self._coming:
                self._coming[one] = self._executor.submit(self._make, one)
        return self._coming.pop(number).result()

    def close(self) -> None:
        """Drop what nobody asked for."""
        self._executor.shutdown(wait=False, cancel_futures=True)
