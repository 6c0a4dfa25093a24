"""What stands on the floor of a bin or on a table, and not the floor itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry.camera import Camera

Array = NDArray[np.float64]
POINTS = 4000  # of an image that planes are fitted to
TRIALS = 300
NEAR = 0.06  # diameters from a plane: on it
ABOVE = 0.15  # diameters from the floor: no longer the floor
LEAST_FLOOR = 0.15  # of the points lie on a floor, or none is seen
LEAST_SUPPORTED = 0.93  # of the points lie on the floor or above it


def above_floor(depth: NDArray[np.float32], camera: Camera, diameter: float) -> NDArray[np.bool_]:
    """Pixels (height, width) with a return that stand higher than the floor; all of them where no floor is seen.

    The floor is the plane with most points on it (RANSAC, Fischler & Bolles 1981) that has next to none behind it.
    """
    known = depth > 0
    points = camera.point_map(depth.astype(float))
    plane = _floor(points[known], diameter)
    if plane is None:
        return known
    normal, offset = plane
    return np.asarray(known & (points @ normal - offset > ABOVE * diameter))


def _floor(points: Array, diameter: float) -> tuple[Array, float] | None:
    """Unit normal (3,) toward the camera and offset of the plane ``points @ normal = offset``; None if none is seen."""
    if len(points) < 3:
        return None
    rng = np.random.default_rng(0)
    some = points[rng.integers(0, len(points), POINTS)]
    best, most = None, LEAST_FLOOR
    for a, b, c in some[rng.integers(0, POINTS, (TRIALS, 3))]:
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length < 1e-9:
            continue
        normal = normal / length * (-1.0 if normal @ a > 0 else 1.0)  # toward the camera, which is at the origin
        height = some @ normal - a @ normal
        on_it = float((np.abs(height) < NEAR * diameter).mean())
        if on_it > most and (height > -ABOVE * diameter).mean() >= LEAST_SUPPORTED:
            best, most = (normal, float(a @ normal)), on_it
    return best
