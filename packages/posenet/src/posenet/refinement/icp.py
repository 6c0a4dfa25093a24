"""Projective point-to-plane ICP of many poses on one depth image, and the small products that its kernels share."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

LEAST_NORMAL_COSINE = 0.4
DAMPING = 1e-3
NEAREST = 1e-3  # meters; nothing is seen that is nearer


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
    damping serves turns and shifts alike, and keeps still what the depth does not determine. `reach` (steps,) is how
    far from the surface depth may lie, in meters, at each step.
    """
    columns, facing = np.ascontiguousarray(points.T), np.ascontiguousarray(normals.T)
    for i in numba.prange(len(pose)):
        rotation = pose[i, :3, :3].copy()
        origin = rotation @ center + pose[i, :3, 3]
        a, b, turn, work = np.empty((6, 6)), np.empty(6), np.empty((3, 3)), np.empty((12, columns.shape[1]))
        for step in range(len(reach)):
            _normal_equations(
                a, b, work, rotation, origin, columns, facing, depth, observed, intrinsics, reach[step], size
            )
            trace = a[0, 0] + a[1, 1] + a[2, 2] + a[3, 3] + a[4, 4] + a[5, 5]
            if trace < 1e-9:
                break
            for r in range(6):
                a[r, r] += DAMPING * trace
            _solve(a, b)
            angle = np.sqrt(b[0] ** 2 + b[1] ** 2 + b[2] ** 2)
            if angle > 1e-12:
                _step_turn(turn, b[0] / angle, b[1] / angle, b[2] / angle, min(angle, 0.3))
                _turn_by(turn, rotation)
            for r in range(3):
                origin[r] += b[3 + r] * size
        pose[i, :3, :3] = rotation
        pose[i, :3, 3] = origin - rotation @ center


@numba.njit(cache=True, fastmath=True)
def _normal_equations(
    a: Any,
    b: Any,
    work: Any,
    rotation: Any,
    origin: Any,
    points: Any,
    normals: Any,
    depth: Any,
    observed: Any,
    intrinsics: Any,
    limit: float,
    size: float,
) -> None:
    """Fill a (6, 6), its upper half, and b (6,) with the weighted residuals of one pose.

    In three passes over columns, of which the first and the last have no branch: processors take eight points at once.
    `work` (12, P) holds the points in the camera's frame, their pixels and whether they face it, and then the rows of
    the equations.
    """
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    _project(work, rotation, origin, points, normals, fx, fy, cx, cy)
    count = 0
    for k in range(points.shape[1]):
        if work[0, k] >= 0.0:
            continue
        u, v = int(work[1, k]), int(work[2, k])
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        seen, z = depth[v, u], work[5, k]
        if seen <= 0.0 or abs(seen - z) > limit:
            continue
        n, m = turned(rotation, normals[:, k]), observed[v, u]
        if m[0] * n[0] + m[1] * n[1] + m[2] * n[2] < LEAST_NORMAL_COSINE:
            continue
        x, y = work[3, k], work[4, k]
        px, py = (u - cx) / fx * seen, (v - cy) / fy * seen
        residual = ((px - x) * m[0] + (py - y) * m[1] + (seen - z) * m[2]) / size
        root = np.sqrt(1.0 / (1.0 + (residual * size / (0.3 * limit)) ** 2))
        qx, qy, qz = (x - origin[0]) / size, (y - origin[1]) / size, (z - origin[2]) / size
        work[6, count] = root * (qy * m[2] - qz * m[1])
        work[7, count] = root * (qz * m[0] - qx * m[2])
        work[8, count] = root * (qx * m[1] - qy * m[0])
        work[9, count], work[10, count], work[11, count] = root * m[0], root * m[1], root * m[2]
        work[0, count] = root * residual  # of a point that was read already
        count += 1
    for r in range(6):
        total = 0.0
        for k in range(count):
            total += work[6 + r, k] * work[0, k]
        b[r] = total
        for c in range(r, 6):
            total = 0.0
            for k in range(count):
                total += work[6 + r, k] * work[6 + c, k]
            a[r, c] = total


@numba.njit(cache=True, fastmath=True)
def _project(
    work: Any, rotation: Any, origin: Any, points: Any, normals: Any, fx: float, fy: float, cx: float, cy: float
) -> None:
    """Into the first rows of `work`: how far each point (3, P) faces away, its pixel, and where it is."""
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    ox, oy, oz = origin[0], origin[1], origin[2]
    # Where the camera stands in the object's frame: whether a point faces it is asked there, without turning normals.
    ex, ey, ez = -(r00 * ox + r10 * oy + r20 * oz), -(r01 * ox + r11 * oy + r21 * oz), -(r02 * ox + r12 * oy + r22 * oz)
    for k in range(points.shape[1]):
        px, py, pz = points[0, k], points[1, k], points[2, k]
        x = r00 * px + r01 * py + r02 * pz + ox
        y = r10 * px + r11 * py + r12 * pz + oy
        z = r20 * px + r21 * py + r22 * pz + oz
        away = normals[0, k] * (px - ex) + normals[1, k] * (py - ey) + normals[2, k] * (pz - ez)
        work[0, k] = away if z > NEAREST else 1.0
        depth = max(z, NEAREST)
        work[1, k] = np.floor(fx * x / depth + cx + 0.5)
        work[2, k] = np.floor(fy * y / depth + cy + 0.5)
        work[3, k], work[4, k], work[5, k] = x, y, z


@numba.njit(cache=True, fastmath=True)
def _solve(a: Any, b: Any) -> None:
    """b becomes the solution of a x = b, a (6, 6) positive definite, of which the upper half is read and overwritten.

    Cholesky's decomposition written out: numba hands even so small a system to LAPACK, which takes ten times as long.
    """
    for r in range(6):
        for k in range(r):
            a[r, r] -= a[k, r] * a[k, r]
        a[r, r] = np.sqrt(a[r, r])
        for c in range(r + 1, 6):
            for k in range(r):
                a[r, c] -= a[k, r] * a[k, c]
            a[r, c] /= a[r, r]
        for k in range(r):
            b[r] -= a[k, r] * b[k]
        b[r] /= a[r, r]
    for r in range(5, -1, -1):
        for c in range(r + 1, 6):
            b[r] -= a[r, c] * b[c]
        b[r] /= a[r, r]


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
def _step_turn(turn: Any, x: float, y: float, z: float, angle: float) -> None:
    """Rodrigues' formula for the unit axis x, y, z, into `turn` (3, 3)."""
    s, c = np.sin(angle), np.cos(angle)
    k = 1.0 - c
    turn[0, 0], turn[0, 1], turn[0, 2] = c + x * x * k, x * y * k - z * s, x * z * k + y * s
    turn[1, 0], turn[1, 1], turn[1, 2] = y * x * k + z * s, c + y * y * k, y * z * k - x * s
    turn[2, 0], turn[2, 1], turn[2, 2] = z * x * k - y * s, z * y * k + x * s, c + z * z * k


@numba.njit(cache=True, fastmath=True)
def _turn_by(turn: Any, rotation: Any) -> None:
    """`rotation` (3, 3) becomes turn @ rotation."""
    for c in range(3):
        x, y, z = turned(turn, rotation[:, c])
        rotation[0, c], rotation[1, c], rotation[2, c] = x, y, z
