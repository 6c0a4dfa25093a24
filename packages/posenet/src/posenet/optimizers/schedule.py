"""How far a run has come, by steps or by the clock, and the learning rate that belongs there."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field


@dataclass
class Budget:
    """A run's length: a number of steps, or minutes of wall-clock time that count on over resumptions."""

    steps: int | None = None
    minutes: float | None = None
    spent_before: float = 0.0  # seconds, in earlier processes of this run
    _started: float = field(default_factory=time.monotonic)

    @property
    def seconds(self) -> float:
        """Wall-clock seconds spent so far."""
        return self.spent_before + time.monotonic() - self._started

    def progress(self, step: int) -> float:
        """Share of the run that is done before `step`, 0 to 1."""
        done = step / self.steps if self.steps is not None else self.seconds / (60.0 * (self.minutes or 1.0))
        return min(done, 1.0)


def learning_rate_factor(progress: float, schedule: str, warmup: float) -> float:
    """The share of the peak learning rate at `progress`.

    `one-cycle` rises linearly and falls as a cosine, `cosine` only falls, `constant` only rises.
    """
    if schedule == "cosine":
        return _falling(progress)
    if progress < warmup:
        return 0.04 + 0.96 * progress / warmup
    if schedule == "constant":
        return 1.0
    return _falling((progress - warmup) / (1.0 - warmup))


def _falling(share: float) -> float:
    return 0.5 * (1.0 + math.cos(math.pi * share)) + 1e-4
