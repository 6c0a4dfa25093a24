"""How noisy a depth image is, from itself alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def depth_noise(depth: NDArray[np.float32]) -> float:
    """The standard deviation (meters) of depth (height, width) on smooth surfaces, along the rows; 0 without returns.

    From how far a pixel is from the mean of its neighbors, so noise that neighbors share is underestimated.
    """
    before, here, after = depth[:, :-2], depth[:, 1:-1], depth[:, 2:]
    known = (before > 0) & (here > 0) & (after > 0)
    if not known.any():
        return 0.0
    bent = np.abs(before[known] - 2 * here[known] + after[known])
    return float(1.4826 * np.median(bent) / np.sqrt(6.0))
