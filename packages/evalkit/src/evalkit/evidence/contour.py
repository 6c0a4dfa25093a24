"""Whether the surface that a pose explains ends where the object does, or goes on beyond it: a wall, or the floor."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray

from evalkit.evidence.ray_tracer import Traced
from evalkit.geometry.camera import Camera

Array = NDArray[np.float64]
BEYOND = 3  # pixels from the silhouette at which the image is asked; nearer, cameras blend both surfaces
PLANE = 0.97  # length of the mean normal of what is seen of a plane
DIRECTIONS = [(down, right) for down, right in product((-1, 0, 1), repeat=2) if (down, right) != (0, 0)]


def share_going_on(
    traced: Traced, depth: NDArray[np.float32], camera: Camera, asked: NDArray[np.bool_], tolerance: float
) -> float:
    """Share of an object's contour beyond which the image shows its surface continued, as a plane, by no edge ended.

    0 where what is seen of the object is no plane: a surface that curves with it is no wall.

    Args:
        depth: (height, width) in meters, 0 = no return.
        asked: (m,) the pixels of `traced` that may be asked: where the image agrees and the surface does not graze.
        tolerance: meters within which a surface is the continued one.
    """
    if not asked.any() or np.linalg.norm(traced.normal[asked].mean(0)) < PLANE:
        return 0.0
    step = math.ceil(BEYOND / traced.stride)
    row, column = ((some - some.min()) // traced.stride + step if len(some) else some for some in (traced.v, traced.u))
    covered = np.zeros((row.max(initial=0) + step + 1, column.max(initial=0) + step + 1), bool)
    covered[row, column] = True
    toward = np.einsum("nk,nk->n", traced.normal, _rays(traced.u, traced.v, camera))
    going_on = total = 0
    for down, right in DIRECTIONS:
        v, u = traced.v + down * step * traced.stride, traced.u + right * step * traced.stride
        inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        ends = asked & inside & ~covered[row + down * step, column + right * step]
        u, v = u[ends], v[ends]
        slope = np.einsum("nk,nk->n", traced.normal[ends], _rays(u, v, camera))
        plane = toward[ends] * traced.depth[ends] / np.minimum(slope, -np.finfo(float).tiny)
        going_on += int((np.abs(depth[v, u] - plane) <= tolerance).sum())
        total += len(u)
    return going_on / max(total, 1)


def _rays(u: NDArray[np.int64], v: NDArray[np.int64], camera: Camera) -> Array:
    """Rays (n, 3) of pixels, one meter along the axis."""
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))], -1)
