"""Whether scores are probabilities: of poses scored 0.9, are nine in ten right?

Expected calibration error over bins of equal width (Naeini, Cooper & Hauskrecht, AAAI 2015).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BINS = 10


@dataclass(frozen=True, eq=False)
class Calibration:
    """Scores in [0, 1] by bins of equal width; NaN where a bin is empty."""

    edges: Array  # (BINS + 1,)
    count: NDArray[np.int64]  # (BINS,)
    score: Array  # (BINS,) mean
    right: Array  # (BINS,) share
    error: float  # mean gap between score and share, each bin by its count; NaN without any score


def calibration(
    score: Array,  # (n,)
    right: NDArray[np.bool_],  # (n,)
) -> Calibration | None:
    """How well scores say what share is right; None where some are beyond [0, 1], which no probability is."""
    if ((score < 0) | (score > 1)).any():
        return None
    which = np.minimum((score * BINS).astype(np.int64), BINS - 1)
    count = np.bincount(which, minlength=BINS)
    with np.errstate(invalid="ignore"):
        mean, share = (np.bincount(which, part, BINS) / count for part in (score, right.astype(float)))
        error = float(np.nansum(count * abs(mean - share)) / len(score)) if len(score) else float("nan")
    return Calibration(np.linspace(0.0, 1.0, BINS + 1, dtype=np.float64), count, mean, share, error)
