"""What a depth image shows at each pixel: how deep it is there, and which way the surface faces."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray


def observed(
    depth: NDArray[np.float32],  # (H, W) meters, 0 = no return
    intrinsics: NDArray[np.float64],  # fx, fy, cx, cy
) -> NDArray[np.float32]:
    """Depth and the unit normal toward the camera (H, W, 4), zeros where nothing returned.

    They lie side by side in memory: what is read of one is in the cache for the other. The normals are those of
    :func:`posenet.network.depth_input.surface_normals`, in a single pass over the image.
    """
    return np.asarray(_observed(np.ascontiguousarray(depth), *intrinsics.astype(np.float32)))


@numba.njit(cache=True, parallel=True, fastmath=True)
def _observed(depth: Any, fx: Any, fy: Any, cx: Any, cy: Any) -> Any:
    height, width = depth.shape
    found = np.zeros((height, width, 4), np.float32)
    for v in numba.prange(height):
        above, below = max(v - 1, 0), min(v + 1, height - 1)
        for u in range(width):
            z = depth[v, u]
            if z <= 0.0:
                continue
            across = _slope(depth[v, max(u - 1, 0)], z, depth[v, min(u + 1, width - 1)], u > 0, u < width - 1)
            down = _slope(depth[above, u], z, depth[below, u], v > 0, v < height - 1)
            nx, ny = fx * across, fy * down
            nz = -(z + (np.float32(u) - cx) * across + (np.float32(v) - cy) * down)
            scale = np.float32(1.0) / np.sqrt(max(nx * nx + ny * ny + nz * nz, np.float32(1e-18)))
            found[v, u, 0] = z
            found[v, u, 1], found[v, u, 2], found[v, u, 3] = nx * scale, ny * scale, nz * scale
    return found


@numba.njit(cache=True, fastmath=True, inline="always")
def _slope(before: Any, here: Any, after: Any, has_before: bool, has_after: bool) -> Any:
    """Change of depth from pixel to pixel: the mean to the neighbors with a return, 0 without any."""
    total, count = np.float32(0.0), np.float32(0.0)
    if has_before and before > 0.0:
        total += here - before
        count += np.float32(1.0)
    if has_after and after > 0.0:
        total += after - here
        count += np.float32(1.0)
    return total / max(count, np.float32(1.0))
