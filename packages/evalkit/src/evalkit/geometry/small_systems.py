"""Small systems of linear equations, to the same last bit on every processor, as LAPACK's solutions are not."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def solve_positive(matrix: ArrayLike, right: ArrayLike) -> Array:
    """Solutions (..., n) of symmetric positive definite matrices (..., n, n) with right sides (..., n).

    By Cholesky's decomposition into L D L^T, in a fixed order.
    """
    a, x = np.array(matrix, float), np.array(right, float)
    count = x.shape[-1]
    for j in range(count):  # below the diagonal a becomes L, on it D
        for k in range(j):
            a[..., j, j] -= a[..., j, k] * a[..., j, k] * a[..., k, k]
        for i in range(j + 1, count):
            for k in range(j):
                a[..., i, j] -= a[..., i, k] * a[..., j, k] * a[..., k, k]
            a[..., i, j] /= a[..., j, j]
    for i in range(count):
        for k in range(i):
            x[..., i] -= a[..., i, k] * x[..., k]
    for i in reversed(range(count)):
        x[..., i] /= a[..., i, i]
        for k in range(i + 1, count):
            x[..., i] -= a[..., k, i] * x[..., k]
    return x
