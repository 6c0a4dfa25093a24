"""Poses on their way through refinement: fits, the best fit of each detection, and what is kept of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Fits(NamedTuple):
    """n fitted poses on their way: which hypothesis each began as, and what the image says of it."""

    cam_from_obj: Array
    hypothesis: NDArray[np.int64]
    agreement: Array
    violation: Array
    evidence: Array  # how the search ranks them

    def select(self, rows: NDArray[np.int64]) -> Fits:
        return Fits._make(part[rows] for part in self)

    def joined(self, other: Fits) -> Fits:
        return Fits._make(np.concatenate(parts) for parts in zip(self, other, strict=True))


class Finalists(NamedTuple):
    """The best fit of each of m detections, and all that is known of them."""

    fits: Fits
    alone: dict[str, Array]  # by name, columns (m,) of what speaks for each alone
    pairs: NDArray[np.int64]  # (p, 2) of fits so near that they may touch
    deep: Array  # (p,) tolerances by which they interpenetrate


@dataclass(frozen=True, eq=False)
class RefinedPoses:
    """m poses after refinement, best first, without those that others explain."""

    cam_from_obj: Array  # (m, 4, 4)
    hypothesis: NDArray[np.int64]  # (m,) which of those given each comes from
    score: Array  # (m,) in [0, 1]
    agreement: Array  # (m,) share of the camera-facing surface that the image shows where the pose has it
    violation: Array  # (m,) share that the camera looks through
