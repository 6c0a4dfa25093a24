"""Tasks on any executor of `concurrent.futures`; those that a dying worker took along are handed out again."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from typing import Protocol, TypeVar

from evalkit.errors import InputError
from simgen.workers.progress import SceneProgress


class Finished(Protocol):
    """What a task brings: so many scenes, after so many drops redone."""

    @property
    def scenes(self) -> int: ...

    @property
    def redone(self) -> int: ...


Result = TypeVar("Result", bound=Finished)
Pool = Callable[[int, SceneProgress], AbstractContextManager[Executor]]  # for so many tasks, reporting scenes
MAX_BROKEN_POOLS = 3


def run_tasks(
    pool: Pool,
    tasks: Iterable[int],
    submit: Callable[[Executor, int], Future[Result]],
    on_done: Callable[[Result], None],
    progress: SceneProgress,
) -> int:
    """Run every task, report each as it is done, in any order; returns how many pools broke.

    Raises:
        InputError: workers keep dying.
    """
    remaining, broken, broken_in_a_row, scenes, redone = set(tasks), 0, 0, 0, 0
    while remaining:
        progress.show(scenes, redone)
        try:
            with pool(len(remaining), progress) as executor:
                futures = {submit(executor, task): task for task in sorted(remaining)}
                for future in as_completed(futures):
                    result = future.result()
                    remaining.discard(futures[future])
                    on_done(result)
                    scenes, redone, broken_in_a_row = scenes + result.scenes, redone + result.redone, 0
                    progress.show(max(scenes, progress.done), max(redone, progress.redone))
        except BrokenProcessPool:
            broken, broken_in_a_row = broken + 1, broken_in_a_row + 1
            if broken_in_a_row > MAX_BROKEN_POOLS:
                raise InputError(
                    "worker processes keep being killed, most likely for lack of memory; "
                    "run the same command again with fewer --workers."
                ) from None
    progress.show(scenes, redone)
    return broken
