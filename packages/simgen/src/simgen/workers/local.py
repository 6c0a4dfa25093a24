"""Worker processes on this machine: they count scenes into a progress bar, and never outlive their parent."""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import AbstractContextManager
from multiprocessing.connection import wait
from typing import Any

from simgen.workers.progress import SceneProgress
from simgen.workers.tasks import Pool

POLL_SECONDS = 0.2
_counters: Any = None  # this worker's share of the pool's scenes done and redone; None in every other process


def processes_here(workers: int) -> Pool:
    """Pools of at most `workers` processes on this machine, for :func:`simgen.workers.tasks.run_tasks`."""

    def pool(tasks: int, progress: SceneProgress) -> AbstractContextManager[Executor]:
        return local_pool(min(workers, tasks), progress)

    return pool


@contextlib.contextmanager
def local_pool(workers: int, progress: SceneProgress) -> Iterator[Executor]:
    """An executor of `workers` processes, ended at once when the block is left by an exception, Ctrl-C included."""
    context = multiprocessing.get_context("spawn")
    counters = context.Array("q", [progress.done, progress.redone])
    others = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(workers, context, _start_worker, (counters,))
    stop = threading.Event()
    thread = threading.Thread(target=_show, args=(progress, counters, stop), daemon=True)
    thread.start()
    try:
        yield executor
        executor.shutdown()
    except BaseException:
        executor.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
            process.join()
        raise
    finally:
        stop.set()
        thread.join()


def count_scene(redone: int) -> None:
    """Report to the pool's owner that a scene is done, after so many drops redone; nothing without a pool."""
    if _counters is not None:
        with _counters.get_lock():
            _counters[0] += 1
            _counters[1] += redone


def _show(progress: SceneProgress, counters: Any, stop: threading.Event) -> None:
    while not stop.wait(POLL_SECONDS):
        progress.show(*counters.get_obj())  # without the lock, which a killed worker may hold for ever


def _start_worker(counters: Any) -> None:
    """Leave Ctrl-C to the parent, and do not outlive it: an orphan would go on writing into the folder."""
    global _counters
    _counters = counters
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.stderr = io.StringIO()  # errors travel as exceptions; h5py prints one more for each buffer it cannot write
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)
