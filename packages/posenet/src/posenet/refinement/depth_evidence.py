"""What a depth image says of poses: how much of each it shows, how much it looks through, what others explain already.

A model is a set of surface points with normals. Asked is at the pixels that its camera-facing points project to:

* the depth there is the point's own, and so is the slope: *agreement*, 1 where both are exactly, 0 at the tolerances;
* it lies in front: another object may hide the point, which says nothing;
* it lies behind: the camera looks through where the surface should be: *violation*.

Points weigh as much as the image sees of their surface.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from posenet.refinement.icp import placed, turned

LEAST_COSINE = 0.5  # of observed and model normal: an agreement beyond 60 degrees is none
ALREADY_EXPLAINED = 0.65  # a pose with more of its support explained by better poses is a duplicate
FOOTPRINT = 0.5  # spacings of the points: half the side of the square of pixels that a point explains


@numba.njit(cache=True, parallel=True, fastmath=True)
def depth_evidence(
    pose: Any, points: Any, normals: Any, depth: Any, observed: Any, intrinsics: Any, tolerance: float
) -> Any:
    """Agreement and violation (n,), shares of the camera-facing surface, of poses (n, 4, 4).

    Args:
        points, normals: (P, 3) of the model's surface. depth: (H, W) meters. observed: (H, W, 3) its normals, zero
            where unknown. intrinsics: fx, fy, cx, cy. tolerance: meters by which depth may differ.
    """
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    agreement, violation = np.zeros(len(pose)), np.zeros(len(pose))
    for i in numba.prange(len(pose)):
        rotation, origin = pose[i, :3, :3].copy(), pose[i, :3, 3].copy()
        facing = agreeing = through = 0.0
        for k in range(len(points)):
            p = placed(rotation, origin, points[k])
            n = turned(rotation, normals[k])
            slant = -(n[0] * p[0] + n[1] * p[1] + n[2] * p[2])
            if p[2] <= 1e-6 or slant <= 0.0:
                continue
            weight = slant / np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
            facing += weight
            u, v = int(np.floor(fx * p[0] / p[2] + cx + 0.5)), int(np.floor(fy * p[1] / p[2] + cy + 0.5))
            if u < 0 or v < 0 or u >= width or v >= height or depth[v, u] <= 0.0:
                continue
            gap = (depth[v, u] - p[2]) / tolerance
            if gap > 1.0:
                through += weight
            elif gap > -1.0:
                m = observed[v, u]
                cosine = m[0] * n[0] + m[1] * n[1] + m[2] * n[2]
                slope = max(0.0, (cosine - LEAST_COSINE) / (1.0 - LEAST_COSINE))
                agreeing += weight * (1.0 - gap * gap) * slope
        if facing > 0.0:
            agreement[i], violation[i] = agreeing / facing, through / facing
    return agreement, violation


@numba.njit(cache=True, fastmath=True)
def explained_before(
    pose: Any,
    order: Any,
    part: Any,
    points: Any,
    normals: Any,
    depth: Any,
    intrinsics: Any,
    tolerance: Any,
    spacing: Any,
) -> Any:
    """Share of each pose's support (n,) that poses earlier in `order` explain; 1 without any support.

    A pose with more than ALREADY_EXPLAINED of it is a duplicate, which explains nothing to those after it. A point
    explains the pixels about it that are as deep as it is, however many they are.

    Args:
        part: (n,) which of k parts each pose is of. points, normals: (k, P, 3) of the parts' surfaces. tolerance,
            spacing: (k,) meters by which depth may differ, and between points.
    """
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    explained = np.zeros((height, width), np.bool_)
    share = np.ones(len(pose))
    pixel, deep = np.empty((points.shape[1], 2), np.int64), np.empty(points.shape[1])
    for i in order:
        rotation, origin, of = pose[i, :3, :3].copy(), pose[i, :3, 3].copy(), part[i]
        count = taken = 0
        for k in range(points.shape[1]):
            p = placed(rotation, origin, points[of, k])
            n = turned(rotation, normals[of, k])
            if p[2] <= 1e-6 or n[0] * p[0] + n[1] * p[1] + n[2] * p[2] >= 0.0:
                continue
            u, v = int(np.floor(fx * p[0] / p[2] + cx + 0.5)), int(np.floor(fy * p[1] / p[2] + cy + 0.5))
            if u < 0 or v < 0 or u >= width or v >= height or abs(depth[v, u] - p[2]) > tolerance[of]:
                continue
            pixel[count, 0], pixel[count, 1], deep[count] = u, v, p[2]
            count += 1
            taken += explained[v, u]
        if count > 0:
            share[i] = taken / count
        if share[i] > ALREADY_EXPLAINED:
            continue
        for k in range(count):
            u, v = pixel[k]
            reach = max(1, int(FOOTPRINT * spacing[of] * fx / deep[k] + 0.5))
            for y in range(max(v - reach, 0), min(v + reach + 1, height)):
                for x in range(max(u - reach, 0), min(u + reach + 1, width)):
                    if abs(depth[y, x] - deep[k]) <= tolerance[of]:
                        explained[y, x] = True
    return share
