"""What speaks for or against a refined pose, whatever its neighbors: what the image shows, and how it was found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from posenet.refinement.appearance import NAMES

Array = NDArray[np.float64]
Apart = Callable[[Array, Array], Array]  # of poses (n, 4, 4) and (n, 4, 4), in thresholds: 1 is the farthest right pose
FARTHEST = 4.0  # thresholds; beyond it makes no difference how far a fit has strayed
SAME = 0.5  # thresholds: fits nearer than this have come to the same pose
LARGEST_MARGIN = 1.0


def as_columns(shown: Array) -> dict[str, Array]:
    """What :func:`posenet.refinement.appearance.appearance` says (n, 11), by name."""
    return dict(zip(NAMES, shown.T, strict=True))


def search_columns(
    chosen: Array,  # (m, 4, 4)
    evidence: Array,  # (m,)
    tried: Array,  # (n, 4, 4)
    tried_evidence: Array,  # (n,)
    of: NDArray[np.int64],  # (n,) row of the chosen fit of the same detection
    apart: Apart,
) -> dict[str, Array]:
    """How clearly the search chose each fit of those tried for its detection, itself among them.

    `margin`: by how much its evidence exceeds that of the best other pose; `stable`: the share that came to it.
    """
    away = apart(tried, chosen[of])
    best_other = np.full(len(chosen), -np.inf)
    np.maximum.at(best_other, of[away > 1.0], tried_evidence[away > 1.0])
    same = np.bincount(of, away < SAME, len(chosen))
    return {
        "margin": np.minimum(evidence - best_other, LARGEST_MARGIN),
        "stable": same / np.maximum(np.bincount(of, minlength=len(chosen)), 1),
    }


def company(count: int, pairs: NDArray[np.int64], away: Array) -> Array:
    """Logarithm of 1 and how many other detections have led to the same pose (count,); `away` (p,) of pairs (p, 2)."""
    same = pairs[away < 1.0]
    return np.log1p(np.bincount(same.ravel(), minlength=count).astype(float))
