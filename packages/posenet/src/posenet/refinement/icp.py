"""Projective point-to-plane ICP of many poses on one depth image, and the small products that its kernels share."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

LEAST_NORMAL_COSINE = 0.4
DAMPING = 1e-3


@numba.njit(cache=True, parallel=True, fastmath=True)
def icp(
    pose: Any,
    points: Any,
    normals: Any,
    center: Any,
    depth: Any,
    observed: Any,
    intrinsics: Any,
    reach: Any,
    size: float,
) -> None:
    """Projective point-to-plane ICP (Chen & Medioni 1991; Blais & Levine 1995), in place, on poses (n, 4, 4).

    `points` (P, 3) are relative to `center`, about which each step turns; lengths are scaled by `size` so that one
    damping serves turns and shifts alike, and keeps still what the depth does not determine.
    """
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    for i in numba.prange(len(pose)):
        rotation = pose[i, :3, :3].copy()
        origin = rotation @ center + pose[i, :3, 3]
        for step in range(len(reach)):
            a = np.zeros((6, 6))
            b = np.zeros(6)
            limit = reach[step]
            row = np.empty(6)
            for k in range(len(points)):
                q = turned(rotation, points[k])
                n = turned(rotation, normals[k])
                x, y, z = q[0] + origin[0], q[1] + origin[1], q[2] + origin[2]
                if z <= 1e-6 or n[0] * x + n[1] * y + n[2] * z >= 0.0:
                    continue
                u, v = int(np.floor(fx * x / z + cx + 0.5)), int(np.floor(fy * y / z + cy + 0.5))
                if u < 0 or v < 0 or u >= width or v >= height:
                    continue
                seen = depth[v, u]
                if seen <= 0.0 or abs(seen - z) > limit:
                    continue
                m = observed[v, u]
                if m[0] * n[0] + m[1] * n[1] + m[2] * n[2] < LEAST_NORMAL_COSINE:
                    continue
                px, py = (u - cx) / fx * seen, (v - cy) / fy * seen
                residual = ((px - x) * m[0] + (py - y) * m[1] + (seen - z) * m[2]) / size
                weight = 1.0 / (1.0 + (residual * size / (0.3 * limit)) ** 2)
                row[0] = (q[1] * m[2] - q[2] * m[1]) / size
                row[1] = (q[2] * m[0] - q[0] * m[2]) / size
                row[2] = (q[0] * m[1] - q[1] * m[0]) / size
                row[3], row[4], row[5] = m[0], m[1], m[2]
                for r in range(6):
                    weighted = weight * row[r]
                    b[r] += weighted * residual
                    for c in range(r + 1):
                        a[r, c] += weighted * row[c]
            trace = a[0, 0] + a[1, 1] + a[2, 2] + a[3, 3] + a[4, 4] + a[5, 5]
            if trace < 1e-9:
                break
            for r in range(6):
                a[r, r] += DAMPING * trace
                for c in range(r):
                    a[c, r] = a[r, c]
            delta = np.linalg.solve(a, b)
            angle = np.sqrt(delta[0] ** 2 + delta[1] ** 2 + delta[2] ** 2)
            if angle > 1e-12:
                rotation = _step_turn(delta[:3] / angle, min(angle, 0.3)) @ rotation
            origin = origin + delta[3:] * size
        pose[i, :3, :3] = rotation
        pose[i, :3, 3] = origin - rotation @ center


@numba.njit(cache=True, fastmath=True, inline="always")
def turned(rotation: Any, v: Any) -> Any:
    """R v, written out: numba hands even so small a product to BLAS, which takes ten times as long."""
    return (
        rotation[0, 0] * v[0] + rotation[0, 1] * v[1] + rotation[0, 2] * v[2],
        rotation[1, 0] * v[0] + rotation[1, 1] * v[1] + rotation[1, 2] * v[2],
        rotation[2, 0] * v[0] + rotation[2, 1] * v[1] + rotation[2, 2] * v[2],
    )


@numba.njit(cache=True, fastmath=True, inline="always")
def placed(rotation: Any, origin: Any, v: Any) -> Any:
    """R v + t."""
    x, y, z = turned(rotation, v)
    return x + origin[0], y + origin[1], z + origin[2]


@numba.njit(cache=True, fastmath=True)
def _step_turn(axis: Any, angle: float) -> Any:
    """Rodrigues' formula."""
    s, c = np.sin(angle), np.cos(angle)
    x, y, z = axis
    k = 1.0 - c
    return np.array(
        [
            [c + x * x * k, x * y * k - z * s, x * z * k + y * s],
            [y * x * k + z * s, c + y * y * k, y * z * k - x * s],
            [z * x * k - y * s, z * y * k + x * s, c + z * z * k],
        ]
    )
