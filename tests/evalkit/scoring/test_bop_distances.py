"""MSSD and MSPD against their definition."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.symmetry import Symmetry
from evalkit.scoring.bop_distances import SYMMETRY_STEPS, Mspd, Mssd, spread_points

CAMERA = Camera(320, 240, 300.0, 310.0, 160.0, 120.0)
INTRINSICS = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, CAMERA.width])


def random_pairs(rng, count):
    turn = poses.from_axis_angle(rng.normal(size=(2 * count, 3)), rng.exponential(0.4, 2 * count))
    both = poses.from_rotation_translation(turn, rng.normal([0, 0, 0.5], 0.01, (2 * count, 3)))
    return both[:count], both[count:]


def by_definition(model, estimate, truth, motion):
    """The largest motion of any point, for the sampled symmetry that makes it smallest."""
    turns = model.symmetry.elements(SYMMETRY_STEPS)
    about = poses.from_rotation_translation(turns, model.centroid - turns @ model.centroid)
    return min(motion(estimate, truth @ g, model.points).max() for g in about)


def in_space(estimate, truth, points):
    return np.linalg.norm(poses.apply(estimate, points) - poses.apply(truth, points), axis=-1)


def in_image(estimate, truth, points):
    gap = CAMERA.project(poses.apply(estimate, points)) - CAMERA.project(poses.apply(truth, points))
    return np.linalg.norm(gap, axis=-1) * 640 / CAMERA.width


@pytest.mark.parametrize(("distance", "motion"), [(Mssd, in_space), (Mspd, in_image)])
def test_they_are_what_their_definition_says(symmetric_model, distance, motion):
    if symmetric_model.symmetry.kind == "sphere":
        pytest.skip("taken exactly, not by samples; see below")
    estimate, truth = random_pairs(np.random.default_rng(0), 12)
    found = distance(symmetric_model)(estimate, truth, np.tile(INTRINSICS, (12, 1)))
    expected = [by_definition(symmetric_model, e, t, motion) for e, t in zip(estimate, truth, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("distance", [Mssd, Mspd])
def test_beyond_the_limit_they_stay_beyond(symmetric_model, distance):
    estimate, truth = random_pairs(np.random.default_rng(1), 40)
    cameras = np.tile(INTRINSICS, (40, 1))
    exact = distance(symmetric_model)(estimate, truth, cameras)
    limit = float(np.median(exact))
    limited = distance(symmetric_model, limit)(estimate, truth, cameras)
    np.testing.assert_array_equal(limited <= limit, exact <= limit)
    np.testing.assert_allclose(limited[exact <= limit], exact[exact <= limit], rtol=1e-12)


def test_a_spheres_mssd_is_the_distance_of_the_centers(plain_model):
    model = plain_model.with_symmetry(Symmetry.parse("sphere"))
    estimate, truth = random_pairs(np.random.default_rng(2), 10)
    gap = np.linalg.norm(model.centers(estimate) - model.centers(truth), axis=1)
    np.testing.assert_allclose(Mssd(model)(estimate, truth), gap, rtol=1e-9)


def test_points_behind_the_camera_are_infinitely_far(plain_model):
    truth = poses.from_rotation_translation(np.eye(3), [[0, 0, 0.5]])
    behind = poses.from_rotation_translation(np.eye(3), [[0, 0, -0.5]])
    assert np.isinf(Mspd(plain_model)(behind, truth, INTRINSICS[None])).all()


def test_spread_points_are_far_apart():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(500, 3))
    few = spread_points(points, 10)
    gaps = np.linalg.norm(few[:, None] - few[None], axis=-1) + 99 * np.eye(10)
    everywhere = np.linalg.norm(points[:, None] - few[None], axis=-1).min(1).max()
    assert gaps.min() >= everywhere  # no point is farther from the chosen than they are from each other
