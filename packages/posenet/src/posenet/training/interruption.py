"""Ctrl-C and SIGTERM that wait for a step to end, so that what is saved is always the state after a whole step."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)
LEFT_ALONE = 2  # exit code of a process whose parent is gone


class Interruption:
    """While entered, both signals raise KeyboardInterrupt: at once, or at the end of what :meth:`held` guards.

    Python takes signals in its main thread alone; in any other this changes nothing.
    """

    def __init__(self) -> None:
        self._holding, self._pending = False, False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._receive) for number in SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler or signal.SIG_DFL)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Guard what must be done as a whole or not at all."""
        self._holding = True
        try:
            yield
        finally:
            self._holding = False
        if self._pending:
            self._pending = False
            raise KeyboardInterrupt

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if not self._holding:
            raise KeyboardInterrupt
        self._pending = True


def leave_to_the_parent() -> None:
    """Called first in a process that another started: Ctrl-C reaches both, and the parent decides; it ends with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_the_parent, daemon=True).start()


def _end_with_the_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(LEFT_ALONE)
