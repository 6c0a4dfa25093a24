"""What a budget will come to, said when the first steps have shown how fast this machine is."""

from __future__ import annotations

import time

from posenet.optimizers.schedule import Budget

FIRST, LAST = 5, 30  # steps: the first ones compile and warm up
# Images of training, AP alone and refined: bunnies, ideal depth, 10 to 20 a bin, half visible; the last row without
# sensors' errors (benchmarks/RESULTS.md).
MEASURED = ((9_800, 0.880, 0.994), (15_900, 0.936, 0.999), (76_800, 0.988, 0.998))


class Forecast:
    """Takes the steps of a process one by one; says once how long the run will take and what such a run has reached."""

    def __init__(self) -> None:
        self._steps, self._started = 0, 0.0

    def after_step(self, budget: Budget, step: int, batch_images: int) -> str | None:
        """The sentence to show after `step` steps of the run, if it is time for it."""
        self._steps += 1
        if self._steps == FIRST:
            self._started = time.monotonic()
        if self._steps != LAST:
            return None
        seconds = (time.monotonic() - self._started) / (LAST - FIRST)
        return forecast(budget, step, batch_images, seconds)


def forecast(budget: Budget, step: int, batch_images: int, seconds: float) -> str:
    """The sentence for a run that has taken `step` steps, the latest of them in so many `seconds` each."""
    left = [float(budget.steps - step)] if budget.steps is not None else []
    left += [(60 * budget.minutes - budget.seconds) / seconds] if budget.minutes is not None else []
    steps = max(0.0, min(left))
    images = (step + steps) * batch_images
    return (
        f"{batch_images / seconds:.1f} images/s here: {steps * seconds / 60:.0f} minutes to go, {images:,.0f} images "
        f"in all. {_reached(images)}"
    )


def _reached(images: float) -> str:
    known = [row for row in MEASURED if row[0] <= images] or [MEASURED[0]]
    count, alone, refined = known[-1]
    return f"Our bunnies reached AP {alone:.3f} alone and {refined:.3f} refined with {count:,} images."
