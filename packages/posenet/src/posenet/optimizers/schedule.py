"""How far a run has come, by steps or by the clock, and the learning rate that belongs there."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

HASTE = 4.0  # so much faster a run goes through what is left of its schedule when it has nothing more to learn


@dataclass
class Budget:
    """A run's length: a number of steps, minutes of wall-clock time that count on over resumptions, or what ends first.

    A longer budget for a run that has begun, or ended, puts it to where it would stand in that one: half of twice the
    time, with the learning rate of there.
    """

    steps: int | None = None
    minutes: float | None = None
    spent_before: float = 0.0  # seconds, in earlier processes of this run
    hurried_from: float | None = None  # the progress at which the run began to hurry, if it did
    _started: float = field(default_factory=time.monotonic)

    @property
    def seconds(self) -> float:
        """Wall-clock seconds spent so far."""
        return self.spent_before + time.monotonic() - self._started

    def progress(self, step: int) -> float:
        """Share of the run that is done before `step`, 0 to 1."""
        shares = [step / self.steps] if self.steps is not None else []
        shares += [self.seconds / (60.0 * self.minutes)] if self.minutes is not None else []
        done = max(shares)
        if self.hurried_from is not None:
            done += (HASTE - 1.0) * max(done - self.hurried_from, 0.0)
        return min(done, 1.0)

    def hurry(self, step: int) -> None:
        """Go through the rest of the schedule, the fall of the learning rate, fast."""
        if self.hurried_from is None:
            self.hurried_from = self.progress(step)

    @property
    def length(self) -> dict[str, float | None]:
        """What a checkpoint notes, to see whether a budget has changed."""
        return {"steps": self.steps, "minutes": self.minutes}


def learning_rate_factor(progress: float, schedule: str, warmup: float, decay: float = 1.0) -> float:
    """The share of the peak learning rate at `progress`.

    `trapezoid` rises linearly, stays, and falls linearly in the last `decay` of the run; `one-cycle` rises linearly and
    falls as a cosine, `cosine` only falls, `constant` only rises.
    """
    if schedule == "cosine":
        return _falling(progress)
    if progress < warmup:
        return 0.04 + 0.96 * progress / warmup
    if schedule == "constant":
        return 1.0
    if schedule == "trapezoid":
        return min(1.0, (1.0 - progress) / decay) + 1e-4
    return _falling((progress - warmup) / (1.0 - warmup))


def _falling(share: float) -> float:
    return 0.5 * (1.0 + math.cos(math.pi * share)) + 1e-4
