"""Principal axes agree with LAPACK's, and are a rotation."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit.geometry import poses
from evalkit.geometry.principal_axes import principal_axes


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e6])
@pytest.mark.parametrize("moments", [(1.0, 2.0, 3.0), (1.0, 1.0, 2.0), (0.0, 1e-12, 1.0), (1.0, 1.0, 1.0)])
def test_they_diagonalize_as_lapacks_do(moments: tuple[float, float, float], scale: float) -> None:
    for turn in poses.random_rotations(np.random.default_rng(0), 20):
        matrix = scale * turn @ np.diag(moments) @ turn.T
        values, axes = principal_axes(matrix)
        assert np.allclose(values, np.linalg.eigvalsh(matrix), rtol=0, atol=1e-14 * scale)
        assert np.allclose(matrix @ axes, axes * values, rtol=0, atol=1e-14 * scale)
        assert np.allclose(axes.T @ axes, np.eye(3), rtol=0, atol=1e-14)
        assert np.linalg.det(axes) > 0


def test_a_matrix_of_zeros_has_the_axes_of_space() -> None:
    values, axes = principal_axes(np.zeros((3, 3)))
    assert not values.any() and np.array_equal(np.abs(axes), np.eye(3))
