"""Projective point-to-plane ICP of many poses on one depth image, and the small products that its kernels share."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

LEAST_NORMAL_COSINE = 0.4
DAMPING = 1e-3
NEAREST = 1e-3  # meters; nothing is seen that is nearer
# Steps after which the points that face the camera are selected anew, with those less than so far turned away (sine).
SELECTED_EVERY, NEARLY_FACING = 4, 0.3


@numba.njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def icp(
    pose: Any, points: Any, normals: Any, center: Any, observed: Any, intrinsics: Any, reach: Any, size: float
) -> None:
    """Projective point-to-plane ICP (Chen & Medioni 1991; Blais & Levine 1995), in place, on poses (n, 4, 4).

    `points` (P, 3) are relative to `center`, about which each step turns; lengths are scaled by `size` so that one
    damping serves turns and shifts alike, and keeps still what the depth does not determine. `observed` (H, W, 4) is
    what :func:`posenet.refinement.observed.observed` gives. `reach` (steps,) is how far from the surface depth may
    lie, in meters, at each step.

    Each step goes over columns of float32 in passes without branches, of which processors do eight points at once;
    what does not count weighs nothing.
    """
    height, width = observed.shape[:2]
    pixels = observed.reshape(height * width, 4)
    for i in numba.prange(len(pose)):
        rotation = pose[i, :3, :3].copy()
        origin = rotation @ center + pose[i, :3, 3]
        a, b, turn = np.empty((6, 6)), np.empty(6), np.empty((3, 3))
        surface, count = np.empty((6, len(points)), np.float32), 0
        seen, index = np.empty((10, len(points)), np.float32), np.empty(len(points), np.int32)
        rows = np.empty((7, len(points)), np.float32)
        for step in range(len(reach)):
            if step % SELECTED_EVERY == 0:
                count = _select(surface, rotation, origin, points, normals)
            _project(seen, index, rotation, origin, surface, count, intrinsics, width, height)
            for k in range(count):
                pixel = pixels[np.uint32(index[k])]
                seen[6, k], seen[7, k], seen[8, k], seen[9, k] = pixel[0], pixel[1], pixel[2], pixel[3]
            _weigh(rows, seen, rotation, origin, surface, count, intrinsics, reach[step], size)
            _normal_equations(a, b, rows, count)
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
def _select(surface: Any, rotation: Any, origin: Any, points: Any, normals: Any) -> Any:
    """Into `surface` (6, P) the points and normals that face the camera, or nearly; returns how many."""
    # Where the camera stands in the object's frame: whether a point faces it is asked there, without turning normals.
    ex, ey, ez = turned(rotation.T, -origin)
    margin = NEARLY_FACING * np.sqrt(ex * ex + ey * ey + ez * ez)
    count = 0
    for k in range(len(points)):
        p, n = points[k], normals[k]
        surface[0, count], surface[1, count], surface[2, count] = p[0], p[1], p[2]
        surface[3, count], surface[4, count], surface[5, count] = n[0], n[1], n[2]
        count += n[0] * (p[0] - ex) + n[1] * (p[1] - ey) + n[2] * (p[2] - ez) < margin
    return count


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _project(
    seen: Any,
    index: Any,
    rotation: Any,
    origin: Any,
    surface: Any,
    count: int,
    intrinsics: Any,
    width: int,
    height: int,
) -> None:
    """Into `seen` whether each point faces the camera within the image, its pixel u, v and where it is: x, y, z.

    `index` becomes the number of its pixel, 0 for those that are not within the image.
    """
    one, zero, half, nearest = np.float32(1.0), np.float32(0.0), np.float32(0.5), np.float32(NEAREST)
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = _entries(rotation)
    ox, oy, oz = np.float32(origin[0]), np.float32(origin[1]), np.float32(origin[2])
    fx, fy, cx, cy = _floats(intrinsics)
    wide, high, columns = np.float32(width), np.float32(height), np.int32(width)
    ex, ey, ez = -(r00 * ox + r10 * oy + r20 * oz), -(r01 * ox + r11 * oy + r21 * oz), -(r02 * ox + r12 * oy + r22 * oz)
    for k in range(count):
        px, py, pz = surface[0, k], surface[1, k], surface[2, k]
        x = r00 * px + r01 * py + r02 * pz + ox
        y = r10 * px + r11 * py + r12 * pz + oy
        z = r20 * px + r21 * py + r22 * pz + oz
        away = surface[3, k] * (px - ex) + surface[4, k] * (py - ey) + surface[5, k] * (pz - ez)
        inverse = one / max(z, nearest)
        u, v = np.floor(fx * x * inverse + cx + half), np.floor(fy * y * inverse + cy + half)
        meets = (away < zero) & (z > nearest) & (u >= zero) & (v >= zero) & (u < wide) & (v < high)
        u, v = (u if meets else zero), (v if meets else zero)
        seen[0, k] = one if meets else zero
        seen[1, k], seen[2, k] = u, v
        seen[3, k], seen[4, k], seen[5, k] = x, y, z
        index[k] = np.int32(v) * columns + np.int32(u)


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _weigh(
    rows: Any,
    seen: Any,
    rotation: Any,
    origin: Any,
    surface: Any,
    count: int,
    intrinsics: Any,
    reach: float,
    size: float,
) -> None:
    """Into `rows` (7, P) each point's row of the equations and its residual, times the root of its weight.

    `seen` (10, P) has besides what :func:`_project` puts there the depth at the pixel and its normal.
    """
    one, zero, least = np.float32(1.0), np.float32(0.0), np.float32(LEAST_NORMAL_COSINE)
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = _entries(rotation)
    ox, oy, oz = np.float32(origin[0]), np.float32(origin[1]), np.float32(origin[2])
    fx, fy, cx, cy = _floats(intrinsics)
    limit, scale, steep = np.float32(reach), np.float32(1.0 / size), np.float32(1.0 / (0.3 * reach))
    ax, ay = one / fx, one / fy
    for k in range(count):
        x, y, z, depth = seen[3, k], seen[4, k], seen[5, k], seen[6, k]
        mx, my, mz = seen[7, k], seen[8, k], seen[9, k]
        nx, ny, nz = surface[3, k], surface[4, k], surface[5, k]
        cosine = (
            mx * (r00 * nx + r01 * ny + r02 * nz)
            + my * (r10 * nx + r11 * ny + r12 * nz)
            + mz * (r20 * nx + r21 * ny + r22 * nz)
        )
        gap = depth - z
        draws = (seen[0, k] > zero) & (depth > zero) & (abs(gap) <= limit) & (cosine >= least)
        residual = ((seen[1, k] - cx) * ax * depth - x) * mx + ((seen[2, k] - cy) * ay * depth - y) * my + gap * mz
        steepness = residual * steep
        root = one / np.sqrt(one + steepness * steepness)
        root = root if draws else zero
        qx, qy, qz = (x - ox) * scale, (y - oy) * scale, (z - oz) * scale
        rows[0, k] = root * (qy * mz - qz * my)
        rows[1, k] = root * (qz * mx - qx * mz)
        rows[2, k] = root * (qx * my - qy * mx)
        rows[3, k], rows[4, k], rows[5, k] = root * mx, root * my, root * mz
        rows[6, k] = root * residual * scale


@numba.njit(cache=True, fastmath=True)
def _normal_equations(a: Any, b: Any, rows: Any, count: int) -> None:
    """Fill a (6, 6), its upper half, and b (6,) with the sums over the weighted rows of one pose."""
    for r in range(6):
        total = np.float32(0.0)
        for k in range(count):
            total += rows[r, k] * rows[6, k]
        b[r] = total
        for c in range(r, 6):
            total = np.float32(0.0)
            for k in range(count):
                total += rows[r, k] * rows[c, k]
            a[r, c] = total


@numba.njit(cache=True, inline="always")
def _entries(rotation: Any) -> Any:
    """The nine numbers of a rotation, row by row, as float32."""
    f = np.float32
    return (
        f(rotation[0, 0]), f(rotation[0, 1]), f(rotation[0, 2]),
        f(rotation[1, 0]), f(rotation[1, 1]), f(rotation[1, 2]),
        f(rotation[2, 0]), f(rotation[2, 1]), f(rotation[2, 2]),
    )  # fmt: skip


@numba.njit(cache=True, inline="always")
def _floats(intrinsics: Any) -> Any:
    """fx, fy, cx, cy as float32."""
    return np.float32(intrinsics[0]), np.float32(intrinsics[1]), np.float32(intrinsics[2]), np.float32(intrinsics[3])


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
