"""Depth images of a surface from far away: what the symmetry test and the search for hidden faces look at.

The surface is drawn as points, dense enough that no pixel which it covers is missed. That is a few lines of numpy,
needs no renderer, and takes some milliseconds for two images, one from either end of a line of sight.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Image = NDArray[np.float32]
STEP = 0.7  # pixels between samples: a grid of that step has a point in every circle of a pixel's width


class DepthViews:
    """Orthographic depth images of a surface within the unit ball about the origin.

    Args:
        vertices, faces: (V, 3) in units of the ball's radius, and (F, 3).
        side: pixels along each side of an image; the ball touches its border.

    Attributes:
        face: (n,) the face that each sample lies on.
        inner: (n,) whether it lies within the face, not on its sides, which other faces share.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, side: int) -> None:
        self.side, self._half = side, (side - 2) / 2
        points, self.face, self.inner = dense_samples(vertices, faces, STEP / self._half)
        inside = points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1.0)  # rounding may leave the ball
        self._points = np.ascontiguousarray(inside.T, np.float32)

    def project(self, cam_from_obj: Array) -> tuple[NDArray[np.intp], Image]:
        """Each sample's flat pixel (n,) and its depth (n,), smaller is nearer, for a rotation (3, 3)."""
        x, y, z = self._points
        u, v, depth = (a * x + b * y + c * z for a, b, c in cam_from_obj.astype(np.float32))  # no BLAS: bits that hold
        half, middle = np.float32(self._half), np.float32(self.side / 2)
        column, row = ((w * half + middle).astype(np.intp) for w in (u, v))
        return row * self.side + column, depth

    def from_both_ends(self, cam_from_obj: Array) -> Image:
        """Depth images (2, side, side) along z and against it, after the rotation (3, 3), in radii.

        A pixel of both is the same line. Smaller is nearer; infinite where there is nothing.
        """
        return self.nearest(*self.project(cam_from_obj)).reshape(2, self.side, self.side)

    def nearest(self, pixel: NDArray[np.intp], depth: Image) -> Image:
        """The least depth (2, side²) on each pixel's line, along it and against it, of what :meth:`project` gives."""
        images = np.full((2, self.side**2), np.inf, np.float32)
        np.minimum.at(images[0], pixel, depth)
        np.minimum.at(images[1], pixel, -depth)
        return images


def dense_samples(
    vertices: ArrayLike, faces: ArrayLike, step: float
) -> tuple[Array, NDArray[np.int64], NDArray[np.bool_]]:
    """Points (n, 3) on triangles, the face (n,) of each, and whether it lies within the face (n,), not on a side.

    They lie `step` apart in rows parallel to each triangle's longest side, and along the other sides: nothing of a
    triangle is farther than 0.71 `step` from one of them.
    """
    corners = np.asarray(vertices, float)[np.asarray(faces)]
    lengths = np.linalg.norm(corners[:, [1, 2, 0]] - corners, axis=2)
    longest, every = lengths.argmax(1), np.arange(len(corners))
    a, b, c = (corners[every, (longest + k) % 3] for k in range(3))
    length = lengths[every, longest]
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(length, np.finfo(float).tiny)
    face, up = _counted(np.ceil(height / step).astype(np.int64) + 1)
    row, along = _counted(np.ceil((1 - up) * length[face] / step).astype(np.int64) + 1)
    inner = (up[row] > 0) & (up[row] < 1) & (along > 0) & (along < 1)
    face, up = face[row], up[row, None]
    left, right = a[face] + up * (c - a)[face], b[face] + up * (c - b)[face]
    points, on = [left + along[:, None] * (right - left)], [face]
    for start, end in ((b, c), (c, a)):
        side, along = _counted(np.ceil(np.linalg.norm(end - start, axis=1) / step).astype(np.int64) + 1)
        points.append(start[side] + along[:, None] * (end - start)[side])
        on.append(side)
    everywhere = np.concatenate(points)
    return everywhere, np.concatenate(on), np.pad(inner, (0, len(everywhere) - len(inner)))


def _counted(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
    """[2, 3] to [0, 0, 1, 1, 1], and how far along each is: [0, 1, 0, 0.5, 1]."""
    which = np.repeat(np.arange(len(counts)), counts)
    step = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    return which, step / np.maximum(counts - 1, 1)[which]


def sphere_directions(count: int) -> Array:
    """Directions (count, 3) spread evenly over the sphere (Fibonacci's spiral)."""
    number = np.arange(count) + 0.5
    z, angle = 1 - 2 * number / count, number * (np.pi * (3 - np.sqrt(5)))
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], -1)
