"""Eigenvectors of symmetric 3 x 3 matrices, to the same last bit on every processor, as LAPACK's are not."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
MAX_SWEEPS = 50  # six or so are needed


def principal_axes(matrix: ArrayLike) -> tuple[Array, Array]:
    """Eigenvalues (3,), ascending, and eigenvectors as the columns of a rotation (3, 3), of a symmetric matrix (3, 3).

    By Jacobi's rotations, in plain float arithmetic of a fixed order. Of the first two axes the largest component is
    positive; the third completes them to a proper rotation.
    """
    a = [[float(x) for x in row] for row in np.asarray(matrix, float)]
    axes = [[float(i == j) for j in range(3)] for i in range(3)]
    for _ in range(MAX_SWEEPS):
        turns = [_rotate(a, axes, p, q) for p, q in ((0, 1), (0, 2), (1, 2))]
        if not any(turns):
            break
    order = sorted(range(3), key=lambda i: a[i][i])
    columns = np.array([[axes[i][j] for i in range(3)] for j in order])
    for column in columns[:2]:
        column *= math.copysign(1.0, column[np.abs(column).argmax()])
    columns[2] = np.cross(columns[0], columns[1])
    return np.array([a[i][i] for i in order]), np.ascontiguousarray(columns.T)


def _rotate(a: list[list[float]], axes: list[list[float]], p: int, q: int) -> bool:
    """Turn in the plane of the axes p and q so that a[p][q] vanishes; False where it is nothing beside the diagonal."""
    if abs(a[p][q]) <= 1e-17 * (abs(a[p][p]) + abs(a[q][q])):
        a[p][q] = a[q][p] = 0.0
        return False
    theta = (a[q][q] - a[p][p]) / (2 * a[p][q])
    tangent = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1))
    cosine = 1 / math.sqrt(tangent * tangent + 1)
    sine = tangent * cosine
    for rows in (a, axes):  # a J, axes J
        for row in rows:
            row[p], row[q] = cosine * row[p] - sine * row[q], sine * row[p] + cosine * row[q]
    for k in range(3):  # J^T a
        a[p][k], a[q][k] = cosine * a[p][k] - sine * a[q][k], sine * a[p][k] + cosine * a[q][k]
    a[p][q] = a[q][p] = 0.0
    return True
