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
from multiprocessing.connection import wait
from typing import Any

from tqdm import tqdm

POLL_SECONDS = 0.2
_scenes_done: Any = None  # this worker's share of the pool's counter; None in every other process


@contextlib.contextmanager
def local_pool(workers: int, bar: tqdm[Any]) -> Iterator[Executor]:
    """An executor of `workers` processes, ended at once when the block is left by an exception, Ctrl-C included."""
    context = multiprocessing.get_context("spawn")
    counter, others = context.Value("q", 0), set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(workers, context, _start_worker, (counter,))
    stop = threading.Event()
    thread = threading.Thread(target=_show, args=(bar, bar.n, counter, stop), daemon=True)
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


def count_scene() -> None:
    """Tell the pool's owner that a scene is done; without a pool, nobody."""
    if _scenes_done is not None:
        with _scenes_done.get_lock():
            _scenes_done.value += 1


def _show(bar: tqdm[Any], start: int, counter: Any, stop: threading.Event) -> None:
    while not stop.wait(POLL_SECONDS):
        done = start + counter.get_obj().value  # without the lock, which a killed worker may hold for ever
        if done > bar.n:
            bar.update(done - bar.n)


def _start_worker(counter: Any) -> None:
    """Leave Ctrl-C to the parent, and do not outlive it: an orphan would go on writing into the folder."""
    global _scenes_done
    _scenes_done = counter
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.stderr = io.StringIO()  # errors travel as exceptions; h5py prints one more for each buffer it cannot write
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)
