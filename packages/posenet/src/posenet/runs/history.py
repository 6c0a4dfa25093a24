"""What the losses did over a run: a row of means every few steps, and the two figures beside the progress bar."""

from __future__ import annotations

import math
import time

from torch import Tensor

ROW_EVERY = 20  # steps
MEMORY = 0.98


class History:
    """Rows {"step", "images", "minutes", "total", one entry a loss}: means over the steps since the row before."""

    def __init__(self) -> None:
        self.rows: list[dict[str, float]] = []
        self.mean, self.rate = math.nan, 0.0  # running mean of the total loss; steps a second
        self._sums: dict[str, tuple[Tensor, int]] = {}
        self._last = time.monotonic()

    def add(self, found: dict[str, Tensor], total: Tensor) -> None:
        """Take in one step's losses."""
        self._time(float(total.detach()))
        for name, value in {"total": total, **found}.items():
            before, count = self._sums.get(name, (0.0, 0))
            self._sums[name] = (value.detach() + before, count + 1)

    def close_row(self, **where: float) -> dict[str, float]:
        """End a row, which `where` places in the run, and return it."""
        row = {**where, **{name: float(value) / count for name, (value, count) in self._sums.items()}}
        self._sums = {}
        self.rows.append(row)
        return row

    def _time(self, loss: float) -> None:
        now = time.monotonic()
        rate = 1.0 / max(now - self._last, 1e-6)
        self._last = now
        first = math.isnan(self.mean)
        self.mean = loss if first else MEMORY * self.mean + (1 - MEMORY) * loss
        self.rate = rate if first else MEMORY * self.rate + (1 - MEMORY) * rate
