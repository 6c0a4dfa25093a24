"""Several processes that train one network: each takes its share of every batch (DDP: gloo on CPUs, NCCL on GPUs).

The process that the user started leads: it alone writes, validates, draws and obeys signals. The others are started
by it, compute their share of each step, and end with it. They need nothing of their own on disk, so a run goes on from
the leader's checkpoint, on as many devices as it is then given. When one fails, all end within seconds.
"""

from __future__ import annotations

import _thread
import contextlib
import logging
import multiprocessing
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait

import torch
from torch import distributed

from evalkit.errors import InputError
from posenet.training.interruption import leave_to_the_parent
from posenet.training.rank import ALONE, Rank

READY = "ready"
LONGEST_FAREWELL = 10.0  # seconds that a process has to say why it ended
GRACE = 3.0  # seconds until what waits for a lost process is interrupted, and as long again until it is ended
FAILED = 2  # exit code

log = logging.getLogger(__name__)


@contextmanager
def processes(size: int, work: Callable[[Rank], None]) -> Iterator[Rank]:
    """Within the block this process leads `size` processes, the others of which run `work`.

    Raises:
        InputError: one of the others met a user's mistake, failed, or ended before the leader did.
    """
    if size == 1:
        yield ALONE
        return
    threads = torch.get_num_threads()
    port = _free_port()
    others = [_Other(Rank(index, size, port), work, threads // size) for index in range(1, size)]
    watch = _Watch(others)
    try:
        for other in others:
            other.wait_until_ready()
        torch.set_num_threads(max(1, threads // size))
        watch.start()
        yield Rank(0, size, port)
    except RuntimeError as error:  # what a collective raises when its peer is gone
        reason = watch.reason(LONGEST_FAREWELL)
        raise InputError(reason) if reason else error from None
    except KeyboardInterrupt:
        if reason := watch.reason():
            raise InputError(reason) from None
        raise
    finally:
        watch.stop()
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
        # No daemon, for those may not start processes, and for a GPU it does; it ends with the leader all the same.
        self.process = context.Process(target=_follow, args=(rank, work, max(1, threads), outbox))
        self.process.start()
        outbox.close()

    def wait_until_ready(self) -> None:
        reason = self._said()
        if reason != READY:
            raise InputError(reason or self._how_it_ended())

    def failure(self) -> str | None:
        """Why it ended; None if it did its work to the end."""
        said = self._said()
        self.process.join(LONGEST_FAREWELL)
        return said or (self._how_it_ended() if self.process.exitcode != 0 else None)

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
            f"{self.rank.title} {how}, so training stopped; the last checkpoint is kept: run the same command again to "
            "resume."
        )


class _Watch(threading.Thread):
    """Ends the leader when another process failed, whatever it is doing: a collective on GPUs would wait for hours."""

    def __init__(self, others: list[_Other]) -> None:
        super().__init__(daemon=True)
        self._others = others
        self._leader_in_main_thread = threading.current_thread() is threading.main_thread()
        self._reason: str | None = None
        self._found, self._over = threading.Event(), threading.Event()

    def reason(self, seconds: float = 0.0) -> str | None:
        """Why one of the others failed, if that is known within so many seconds."""
        self._found.wait(seconds)
        return self._reason

    def stop(self) -> None:
        """The leader's work is over: nothing is watched any longer."""
        self._over.set()

    def run(self) -> None:
        running = {other.process.sentinel: other for other in self._others}
        while running and not self._over.is_set():
            for sentinel in wait(list(running), timeout=0.2):
                assert isinstance(sentinel, int)
                self._reason = running.pop(sentinel).failure()
                if self._reason is not None:
                    self._found.set()
                    return self._end_the_leader(self._reason)

    def _end_the_leader(self, reason: str) -> None:
        if self._over.wait(GRACE):
            return  # a collective has noticed by itself
        if self._leader_in_main_thread:
            _thread.interrupt_main()  # of validation, or between two steps
            if self._over.wait(GRACE):
                return
        log.critical("Error: %s", reason)
        os._exit(FAILED)  # out of a collective that cannot be interrupted


def _follow(rank: Rank, work: Callable[[Rank], None], threads: int, outbox: Connection) -> None:
    """All that a process beside the leader does."""
    leave_to_the_parent()
    torch.set_num_threads(threads)
    outbox.send_bytes(READY.encode())
    try:
        work(rank)
    except (InputError, OSError) as error:
        _say(outbox, str(error))
        os._exit(FAILED)
    except Exception as error:
        log.debug("%s failed", rank.title, exc_info=True)
        _say(outbox, f"{rank.title} failed ({type(error).__name__}: {error}), so training stopped.")
        os._exit(FAILED)
    os._exit(0)  # without the farewells of a process group that may have lost its leader


def _say(outbox: Connection, words: str) -> None:
    with contextlib.suppress(OSError):
        outbox.send_bytes(words.encode())


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
