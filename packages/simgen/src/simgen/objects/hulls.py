"""Convex hulls of few vertices, for the physics, whose time grows with them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

Array = NDArray[np.float64]
MARGIN = 0.9  # vertices move along normals, so the planes between them move a little less


def simplified_hull(points: Array, tolerance: float) -> Array:
    """Vertices (V, 3) of a convex body whose surface is nowhere farther than `tolerance` from the points' hull.

    Of the hull's vertices those farthest outside are taken one by one; what then still stands out is shared between
    inside and outside by moving the vertices outwards, so a ball needs half of the vertices. A body of few vertices
    stays as it is. Fewer than four points, or flat ones, come back unchanged.
    """
    try:
        corners = points[ConvexHull(points).vertices]
        chosen = np.unique(np.concatenate([corners.argmin(0), corners.argmax(0)]))
        while len(chosen) < len(corners):
            hull = ConvexHull(corners[chosen]) if len(chosen) > 3 else None
            outside = _outside(hull, corners)
            if hull is not None and outside.max() <= 2 * MARGIN * tolerance:
                grown = _grown(hull, outside.max() / 2)
                if _outside(ConvexHull(grown), corners).max() <= tolerance:
                    return grown
            chosen = np.append(chosen, _farthest(outside, chosen))
    except QhullError:
        return points
    return corners


def _outside(hull: ConvexHull | None, corners: Array) -> Array:
    """How far each corner (n,) stands out of a hull; of none, how far from the middle."""
    if hull is None:
        return np.linalg.norm(corners - corners.mean(0), axis=1)
    x, y, z = (corners[:, axis, None] * hull.equations[:, axis] for axis in range(3))  # no BLAS: bits that hold
    return (x + y + z + hull.equations[:, 3]).max(1)


def _farthest(outside: Array, chosen: NDArray[np.int64]) -> int:
    free = outside.copy()
    free[chosen] = -np.inf
    return int(free.argmax())


def _grown(hull: ConvexHull, distance: float) -> Array:
    """The hull's vertices, each moved outwards by `distance` along the mean normal of its faces."""
    normals = np.zeros_like(hull.points)
    for corner in range(3):
        np.add.at(normals, hull.simplices[:, corner], hull.equations[:, :3])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return hull.points + distance * normals / np.where(length > 0, length, 1.0)
