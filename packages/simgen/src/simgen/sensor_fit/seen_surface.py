"""The surface behind a depth image: what the camera looked at, as far as one image, or several of one scene, say it.

Everything is in inverse depth q = fx / z, pixels a meter: the disparity that a baseline of one meter would give, in
which planes are affine and a triangulating camera's errors do not depend on the distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, distance_transform_edt

from evalkit.geometry.camera import Camera
from simgen.compiled import compiled

RADIUS = 3  # pixels, of the window in which a quadric is fitted
STEP = 6.0  # slope (80.5 degrees) between neighbors from which on a step lies between them
SAME = 4.0  # slope up to which pixels of a window count as its middle's surface
LEAST_PIECE = 80  # pixels; smaller pieces between steps are no surface, but wrong depth
WIDEST_HOLE = 21  # pixels; what is missing over wider areas was out of sight or cut away, not lost
MARGIN = 8  # pixels from such an area, or from the image's border, which tell nothing of the sensor
LEAST_POINTS = 10  # of a window, to fit a plane

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Surface:
    """What was looked at.

    Attributes:
        q: (H, W) inverse depth, smooth between steps, defined everywhere.
        away: (H, W) where whole areas are missing: out of sight or cut away.
        counted: (H, W) where it is known well enough to say that a return is missing: not there, and not close by.
        full: (H, W) where the whole window lies on one surface and has returned.
        flying: (H, W) returns that belong to no surface.
    """

    q: Image
    away: Mask
    counted: Mask
    full: Mask
    flying: Mask


def surface_of(q: Image, fx: float) -> Surface:
    """The surface behind one image (H, W) of inverse depth, 0 = no return."""
    valid = q > 0
    flying = valid & _small_pieces(_nearest(q, valid), fx / STEP, LEAST_PIECE)
    kept = valid & ~flying
    if not kept.any():
        kept, flying = valid, np.zeros_like(valid)
    filled = _nearest(q, kept)
    smooth, full = _smoothed(filled, kept, fx, _quadric_weights(RADIUS))
    away = _out_of_sight(valid)
    return Surface(smooth, away, np.asarray(binary_erosion(~away, np.ones((3, 3)), MARGIN)), full, flying)


def surfaces_of(depths: Sequence[Image], camera: Camera, static: bool) -> list[Surface]:
    """The surfaces behind depth images (H, W) in meters; where they show one scene, that of their median for all."""
    every = [inverse_depth(depth, camera) for depth in depths]
    if not static:
        return [surface_of(q, camera.fx) for q in every]
    stack = np.stack(every)
    seen = (stack > 0).any(0)
    median = np.zeros(stack.shape[1:], np.float32)
    median[seen] = np.nanmedian(np.where(stack > 0, stack, np.nan)[:, seen], axis=0)
    return [surface_of(median, camera.fx)] * len(every)


def inverse_depth(depth: Image, camera: Camera) -> Image:
    """fx / z (H, W), 0 where nothing returned."""
    return np.divide(np.float32(camera.fx), depth, out=np.zeros_like(depth, np.float32), where=depth > 0)


def _out_of_sight(valid: Mask) -> Mask:
    """Where (H, W) a disc as wide as no sensor's loss fits into what is missing."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (WIDEST_HOLE, WIDEST_HOLE))
    padded = np.pad((~valid).astype(np.uint8), WIDEST_HOLE, constant_values=1)
    opened = cv2.morphologyEx(padded, cv2.MORPH_OPEN, disc)
    return np.asarray(opened[WIDEST_HOLE:-WIDEST_HOLE, WIDEST_HOLE:-WIDEST_HOLE] > 0)


def slope_of(q: Image, fx: float, fy: float) -> Image:
    """Tangent (H, W) of the angle between the surface and the image plane, as the sensor's model has it."""
    padded = np.pad(q, 1, mode="reflect")
    right, left = np.abs(padded[1:-1, 2:] - q), np.abs(q - padded[1:-1, :-2])
    below, above = np.abs(padded[2:, 1:-1] - q), np.abs(q - padded[:-2, 1:-1])
    return np.asarray(np.hypot(fx * np.minimum(left, right), fy * np.minimum(above, below)) / q, np.float32)


def _nearest(q: Image, valid: Mask) -> Image:
    """Every pixel as the nearest valid one."""
    rows, columns = distance_transform_edt(~valid, return_distances=False, return_indices=True)
    return np.ascontiguousarray(q[rows, columns], np.float32)


def _quadric_weights(radius: int) -> NDArray[np.float64]:
    """Weights (side, side) by which a window's values give the middle of the quadric fitted to them."""
    v, u = (axis.ravel().astype(float) for axis in np.mgrid[-radius : radius + 1, -radius : radius + 1])
    design = np.column_stack([np.ones_like(u), u, v, u * u, u * v, v * v])
    return np.asarray(np.linalg.pinv(design)[0].reshape(2 * radius + 1, -1))


@compiled
def _small_pieces(q, scale, least):  # type: ignore[no-untyped-def]
    """Pixels (H, W) of pieces with fewer than `least` pixels; steps are where |dq| * scale exceeds the farther q."""
    height, width = q.shape
    label = np.zeros((height, width), np.int32)
    small = np.zeros((height, width), np.bool_)
    stack = np.empty((height * width, 2), np.int32)
    piece = 0
    for v0 in range(height):
        for u0 in range(width):
            if label[v0, u0] > 0:
                continue
            piece += 1
            label[v0, u0] = piece
            stack[0, 0], stack[0, 1] = v0, u0
            count, looked = 1, 0
            while looked < count:
                v, u = stack[looked]
                looked += 1
                for j, i in ((0, 1), (0, -1), (1, 0), (-1, 0)):
                    y, x = v + j, u + i
                    if not (0 <= y < height and 0 <= x < width) or label[y, x] > 0:
                        continue
                    if abs(q[y, x] - q[v, u]) * scale <= min(q[y, x], q[v, u]):
                        label[y, x] = piece
                        stack[count, 0], stack[count, 1] = y, x
                        count += 1
            if count < least:
                for k in range(count):
                    small[stack[k, 0], stack[k, 1]] = True
    return small


@compiled
def _smoothed(filled, kept, fx, weights):  # type: ignore[no-untyped-def]
    """The middle of what fits each window's pixels of one surface: a quadric where all are, else a plane."""
    height, width = filled.shape
    radius = weights.shape[0] // 2
    out, full = filled.copy(), np.zeros((height, width), np.bool_)
    for v in range(height):
        for u in range(width):
            here = filled[v, u]
            n = su = sv = suu = suv = svv = sq = suq = svq = quadric = 0.0
            known = True
            for j in range(-radius, radius + 1):
                for i in range(-radius, radius + 1):
                    y, x = v + j, u + i
                    if not (0 <= y < height and 0 <= x < width):
                        known = False
                        continue
                    value = filled[y, x]
                    if abs(value - here) * fx > SAME * here * max(abs(i), abs(j), 1):
                        known = False
                        continue
                    known = known and kept[y, x]
                    n += 1.0
                    su += i
                    sv += j
                    suu += i * i
                    suv += i * j
                    svv += j * j
                    sq += value
                    suq += i * value
                    svq += j * value
                    quadric += weights[j + radius, i + radius] * value
            full[v, u] = known
            if n == weights.size:
                out[v, u] = quadric
            elif n >= LEAST_POINTS:
                a, b, c = suu - su * su / n, suv - su * sv / n, svv - sv * sv / n
                d, e = suq - su * sq / n, svq - sv * sq / n
                determinant = a * c - b * b
                if determinant > 1e-6:
                    gu, gv = (d * c - e * b) / determinant, (a * e - b * d) / determinant
                    out[v, u] = (sq - gu * su - gv * sv) / n
    return out, full
