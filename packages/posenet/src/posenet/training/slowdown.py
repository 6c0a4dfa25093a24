"""Notices that training has become several times slower than it was: threads wait for each other on busy cores."""

from __future__ import annotations

FACTOR = 3.0


class Slowdown:
    """Takes the running rate of a training step by step; says once when it fell to a third of its best."""

    def __init__(self) -> None:
        self._best, self._warned = 0.0, False

    def warning(self, rate: float) -> str | None:
        """The warning to show now that training runs at `rate` images/s, if there is one."""
        self._best = max(self._best, rate)
        if self._warned or rate * FACTOR > self._best:
            return None
        self._warned = True
        return (
            f"Training has slowed from {self._best:.1f} to {rate:.1f} images/s; do other programs use the cores? "
            "Threads that wait for each other lose most there: stop the others, or stop this (Ctrl-C keeps its state) "
            "and go on with OMP_NUM_THREADS=1 before the same command."
        )
