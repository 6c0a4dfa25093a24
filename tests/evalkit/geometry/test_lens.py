"""Lenses: OpenCV is the oracle of the model, and rectifying undoes what distorting did."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.geometry.lens import Lens

CAMERA = Camera(160, 120, 150.0, 148.0, 81.0, 58.5)
COEFFICIENTS = {
    "four": (-0.3, 0.1, 0.002, -0.001),
    "plumb bob": (-0.3, 0.1, 0.002, -0.001, 0.05),
    "rational": (0.4, -0.2, 0.001, 0.0005, 0.01, 0.7, -0.1, 0.02),
    "thin prism": (0.1, 0.05, 0, 0, 0, 0, 0, 0, 0.01, -0.02, 0.005, 0.003),
}


@pytest.mark.parametrize("coefficients", COEFFICIENTS.values(), ids=COEFFICIENTS)
def test_the_pixels_of_an_image_are_those_that_opencv_finds(coefficients: tuple[float, ...]) -> None:
    size = (CAMERA.width, CAMERA.height)
    u, v = cv2.initUndistortRectifyMap(CAMERA.matrix, np.array(coefficients), None, CAMERA.matrix, size, cv2.CV_32FC1)
    ours = Lens(coefficients).image_pixels(CAMERA)
    np.testing.assert_allclose(ours, np.stack([u, v], -1), atol=1e-3)


@pytest.mark.parametrize("radial_first", [False, True])
def test_the_inverse_model_undoes_the_model(radial_first: bool) -> None:
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (200, 2))
    coefficients = (-0.2, 0.05, 0.002, -0.001, 0.01)
    moved = Lens(coefficients, radial_first=radial_first).distort(points)
    assert np.abs(moved - points).max() > 1e-2
    back = Lens(coefficients, inverse=True, radial_first=radial_first).distort(moved)
    np.testing.assert_allclose(back, points, atol=1e-6)


def test_a_rectified_plane_is_flat_and_a_step_lies_where_the_pinhole_camera_sees_it() -> None:
    """A wall whose left half is nearer, as a distorting camera takes it: rectified, the step is one column again."""
    lens = Lens((-0.3, 0.1, 0.0, 0.0), skew=3.0)
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    normalized = np.stack(
        [(u - CAMERA.cx - lens.skew * (v - CAMERA.cy) / CAMERA.fy) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy], -1
    )
    x = cv2.undistortPoints(normalized.reshape(-1, 1, 2), np.eye(3), np.array(lens.coefficients)).reshape((*u.shape, 2))
    taken = np.where(x[..., 0] < 0.1, 0.7, 0.9).astype(np.float32)
    rectified = lens.rectify(taken, CAMERA)
    expected = np.where((u - CAMERA.cx) / CAMERA.fx < 0.1, 0.7, 0.9)
    seen = rectified > 0
    near_the_step = np.abs((u - CAMERA.cx) / CAMERA.fx - 0.1) * CAMERA.fx <= 1.0
    assert seen.mean() > 0.95
    np.testing.assert_allclose(rectified[seen & ~near_the_step], expected[seen & ~near_the_step], atol=1e-6)
    assert (np.abs(taken - expected) > 0.1).sum() > 50  # which it was not before


def test_where_the_model_folds_over_itself_nothing_is_seen() -> None:
    wide = Camera(160, 120, 40.0, 40.0, 79.5, 59.5)
    depth = np.ones((120, 160), np.float32)
    rectified = Lens((-0.3, 0.0, 0.0, 0.0)).rectify(depth, wide)
    radius = np.hypot(*np.meshgrid((np.arange(160) - 79.5) / 40, (np.arange(120) - 59.5) / 40))
    assert (rectified[radius < 1.0] == 1).all()
    assert (rectified[radius > 1.1] == 0).all()


def test_an_image_of_another_size_is_refused() -> None:
    with pytest.raises(InputError, match="160 x 120"):
        Lens((-0.3, 0.1, 0.0, 0.0)).rectify(np.ones((160, 120)), CAMERA)
