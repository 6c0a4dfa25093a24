"""Hulls of few vertices hold the surface within a tolerance, on both sides."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from simgen.objects.hulls import simplified_hull

BODIES = {
    "ball": trimesh.creation.icosphere(4, 0.5),
    "cylinder": trimesh.creation.cylinder(0.2, 1.0, sections=128),
    "capsule": trimesh.creation.capsule(0.6, 0.2),
    "needle": trimesh.creation.cone(0.02, 1.0, sections=64),
    "random": trimesh.convex.convex_hull(np.random.default_rng(0).normal(size=(2000, 3)) / 4),
}


def excess(points: NDArray[np.float64], hull_of: NDArray[np.float64]) -> float:
    """How far points stand out of the hull of others."""
    planes = ConvexHull(hull_of).equations
    return float((points @ planes[:, :3].T + planes[:, 3]).max())


@pytest.mark.parametrize("tolerance", [0.02, 0.005])
@pytest.mark.parametrize("name", BODIES)
def test_no_point_stands_out_and_nothing_is_added_beyond_the_tolerance(name: str, tolerance: float) -> None:
    points = np.array(BODIES[name].vertices)
    simple = simplified_hull(points, tolerance)
    assert excess(points, simple) <= tolerance + 1e-12
    assert excess(simple, points) <= tolerance + 1e-12
    assert len(simple) <= len(points)


def test_a_ball_keeps_its_volume_with_a_tenth_of_its_vertices() -> None:
    ball = BODIES["ball"]
    simple = simplified_hull(np.array(ball.vertices), 0.005)
    assert len(simple) < len(ball.vertices) / 10
    assert ConvexHull(simple).volume == pytest.approx(ball.volume, rel=0.01)


def test_a_box_stays_a_box() -> None:
    box = trimesh.creation.box((1, 0.5, 0.2)).subdivide().subdivide()
    simple = simplified_hull(np.array(box.vertices), 0.005)
    assert len(simple) == 8
    assert ConvexHull(simple).volume == pytest.approx(0.1)


@pytest.mark.parametrize("points", [np.zeros((2, 3)), np.eye(3), np.zeros((9, 3)), np.eye(4)[:, :3] * [1, 1, 0]])
def test_what_has_no_volume_comes_back_as_it_is(points: NDArray[np.float64]) -> None:
    assert simplified_hull(points, 0.005) is points
