"""How far across an object is, as BOP measures it."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ROWS_AT_ONCE = 500


def largest_distance(points: Array) -> float:
    """Between any two of `points` (n, 3); those of their convex hull will do."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import
    from scipy.spatial.distance import cdist

    with suppress(QhullError):  # they are flat
        points = points[ConvexHull(points).vertices]
    chunks = range(0, len(points), ROWS_AT_ONCE)
    return max(float(cdist(points[start : start + ROWS_AT_ONCE], points).max()) for start in chunks)
