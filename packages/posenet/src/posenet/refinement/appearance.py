"""What a depth image shows of posed objects, in shares that mean the same for every part and camera.

The surface points that a camera would see of a pose are found by a coarse depth buffer of their own, so that what the
object hides of itself counts for nothing. Each is compared with the depth at its pixel, and each cell of the outline
with the depth just outside of it: where the object ends the image should show something deeper. The buffer is coarse:
cells that no point falls into pass for outlines too, so that only about two thirds of a true pose's outline are met.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from posenet.refinement.icp import placed, turned

NAMES = (
    "agreement",  # shares of the visible surface: as deep and as slanted as the image says, with falling weight
    "through",  # the camera looks through it
    "far through",  # by three tolerances and more
    "hidden",  # something is in front of it
    "near",  # within the tolerance, however slanted
    "fine",  # of what is near: within a quarter of it
    "residual",  # of what is near: mean difference, tolerances
    "slope",  # of what is near: mean cosine of the normals
    "outline seen",  # share of the outline's cells whose surface is near
    "outline met",  # of those: it is deeper outside
    "outline missed",  # of those: the surface goes on
)
CELLS = 24  # of the depth buffer, a side
FAR = 1e9  # no infinity: fast arithmetic does not know it
MARGIN = 1.15  # diameters that it spans
SELF_HIDDEN = 0.07  # diameters behind the nearest point of the cell


@numba.njit(cache=True, parallel=True, fastmath=True)
def appearance(
    pose: Any,
    points: Any,
    normals: Any,
    center: Any,
    diameter: float,
    depth: Any,
    observed: Any,
    intrinsics: Any,
    tolerance: float,
) -> Any:
    """The numbers of NAMES (n, 11) for poses (n, 4, 4).

    Args:
        points, normals: (P, 3) of the model's surface. center: (3,) of the model. depth: (H, W) meters. observed:
            (H, W, 3) its normals, zero where unknown. intrinsics: fx, fy, cx, cy. tolerance: meters.
    """
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    found = np.zeros((len(pose), len(NAMES)))
    for i in numba.prange(len(pose)):
        rotation, origin = pose[i, :3, :3].copy(), pose[i, :3, 3].copy()
        middle = placed(rotation, origin, center)
        reach = max(middle[2], 0.1 * diameter)
        cell = MARGIN * diameter / reach / CELLS  # in tangents
        left, top = middle[0] / reach - cell * CELLS / 2, middle[1] / reach - cell * CELLS / 2
        nearest = np.full((CELLS, CELLS), FAR)
        at = np.empty((len(points), 3))
        for k in range(len(points)):
            p = placed(rotation, origin, points[k])
            at[k, 0], at[k, 1], at[k, 2] = p
            if p[2] <= 1e-6:
                continue
            column, row = int((p[0] / p[2] - left) / cell), int((p[1] / p[2] - top) / cell)
            if 0 <= column < CELLS and 0 <= row < CELLS:
                nearest[row, column] = min(nearest[row, column], p[2])
        total = near = slopes = gaps = fine = 0.0
        for k in range(len(points)):
            n = turned(rotation, normals[k])
            x, y, z = at[k]
            slant = -(n[0] * x + n[1] * y + n[2] * z)
            if z <= 1e-6 or slant <= 0.0:
                continue
            column, row = int((x / z - left) / cell), int((y / z - top) / cell)
            if 0 <= column < CELLS and 0 <= row < CELLS and z > nearest[row, column] + SELF_HIDDEN * diameter:
                continue
            weight = slant / np.sqrt(x * x + y * y + z * z)
            total += weight
            u, v = int(np.floor(fx * x / z + cx + 0.5)), int(np.floor(fy * y / z + cy + 0.5))
            if u < 0 or v < 0 or u >= width or v >= height or depth[v, u] <= 0.0:
                continue
            gap = (depth[v, u] - z) / tolerance
            if gap > 1.0:
                found[i, 1] += weight
                if gap > 3.0:
                    found[i, 2] += weight
            elif gap < -1.0:
                found[i, 3] += weight
            else:
                m = observed[v, u]
                cosine = max(0.0, m[0] * n[0] + m[1] * n[1] + m[2] * n[2])
                near += weight
                gaps += weight * abs(gap)
                slopes += weight * cosine
                if abs(gap) < 0.25:
                    fine += weight
                found[i, 0] += weight * (1.0 - gap * gap) * max(0.0, 2.0 * cosine - 1.0)
        rim = seen = met = missed = 0
        for row in range(CELLS):
            for column in range(CELLS):
                z = nearest[row, column]
                if z >= FAR:
                    continue
                here = _at(depth, left, top, cell, row, column, intrinsics)
                agrees = here > 0.0 and abs(here - z) <= tolerance
                for side in range(4):
                    r, c = row + (side == 0) - (side == 1), column + (side == 2) - (side == 3)
                    if 0 <= r < CELLS and 0 <= c < CELLS and nearest[r, c] < FAR:
                        continue
                    rim += 1
                    seen += agrees
                    outside = _at(depth, left, top, cell, r, c, intrinsics)
                    if agrees and outside > 0.0:
                        met += outside > z + tolerance
                        missed += abs(outside - z) <= tolerance
        if total > 0.0:
            for column in range(4):
                found[i, column] /= total
            found[i, 4] = near / total
        if near > 0.0:
            found[i, 5], found[i, 6], found[i, 7] = fine / near, gaps / near, slopes / near
        found[i, 8] = seen / max(rim, 1)
        found[i, 9], found[i, 10] = met / max(seen, 1), missed / max(seen, 1)
    return found


@numba.njit(cache=True, fastmath=True, inline="always")
def _at(depth: Any, left: float, top: float, cell: float, row: int, column: int, intrinsics: Any) -> Any:
    """Depth at the middle of a cell; 0 where nothing returned or beyond the frame."""
    fx, fy, cx, cy = intrinsics
    u = int(np.floor(fx * (left + (column + 0.5) * cell) + cx + 0.5))
    v = int(np.floor(fy * (top + (row + 0.5) * cell) + cy + 0.5))
    if u < 0 or v < 0 or u >= depth.shape[1] or v >= depth.shape[0]:
        return 0.0
    return depth[v, u]
