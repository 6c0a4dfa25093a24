"""Small systems are solved as LAPACK solves them, one or many at a time."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit.geometry.small_systems import solve_positive


@pytest.mark.parametrize("size", [1, 2, 3, 6])
def test_it_solves_as_lapack_does(size: int) -> None:
    rng = np.random.default_rng(size)
    rows, right = rng.normal(size=(7, 20, size)), rng.normal(size=(7, size))
    matrices = np.swapaxes(rows, 1, 2) @ rows
    expected = np.linalg.solve(matrices, right[..., None])[..., 0]
    np.testing.assert_allclose(solve_positive(matrices, right), expected, rtol=1e-10)
    np.testing.assert_allclose(solve_positive(matrices[0], right[0]), expected[0], rtol=1e-10)
