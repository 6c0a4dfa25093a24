"""Distances to a sampled surface, against trimesh's exact ones."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from evalkit.geometry import poses
from evalkit.objects.surface import GRID_CELLS, Surface

BODIES = {
    "box": trimesh.creation.box((1.0, 2.0, 3.0)),
    "ball": trimesh.creation.icosphere(3),
    "needle": trimesh.creation.box((0.1, 0.1, 4.0)),
    "ring": trimesh.creation.torus(1.0, 0.2),
}


@pytest.fixture(params=BODIES, scope="module")
def body(request: pytest.FixtureRequest) -> tuple[trimesh.Trimesh, Surface]:
    mesh = BODIES[request.param].copy().apply_translation([5.0, 0, 0])
    return mesh, Surface.from_mesh(mesh.vertices, mesh.faces)


def exact_distance(mesh: trimesh.Trimesh, surface: Surface, points: np.ndarray) -> np.ndarray:
    _, distance, _ = trimesh.proximity.closest_point_naive(mesh, points * surface.radius + surface.centroid)
    return distance / surface.radius


def test_points_of_the_surface_are_on_it(body: tuple[trimesh.Trimesh, Surface]) -> None:
    mesh, surface = body
    others = trimesh.sample.sample_surface(mesh, 500, seed=1)[0]
    distance = surface.distance((others - surface.centroid) / surface.radius)
    assert np.quantile(distance, 0.95) < 0.003
    assert distance.max() < 2 * surface.spacing


def test_distances_are_exact_to_a_spacing(body: tuple[trimesh.Trimesh, Surface]) -> None:
    mesh, surface = body
    points = np.random.default_rng(0).uniform(-0.7, 0.7, (300, 3))
    assert surface.distance(points) == pytest.approx(exact_distance(mesh, surface, points), abs=1.5 * surface.spacing)


def test_rough_distances_are_exact_to_two_cells(body: tuple[trimesh.Trimesh, Surface]) -> None:
    mesh, surface = body
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (300, 3))
    rough = surface.rough_distance(points.reshape(3, 100, 3))
    assert rough.shape == (3, 100)
    assert rough.ravel() == pytest.approx(exact_distance(mesh, surface, points), abs=2 * 2 / GRID_CELLS)


def test_the_surface_is_in_units_of_its_radius_about_its_centroid(body: tuple[trimesh.Trimesh, Surface]) -> None:
    mesh, surface = body
    assert surface.centroid == pytest.approx(mesh.area_faces @ mesh.triangles_center / mesh.area)
    assert np.linalg.norm(surface.points, axis=1).max() == pytest.approx(1.0, abs=0.02)
    assert surface.points.mean(0) == pytest.approx(np.zeros(3), abs=0.01)


def test_moving_and_scaling_a_body_changes_no_distance(body: tuple[trimesh.Trimesh, Surface]) -> None:
    mesh, surface = body
    rotation = poses.random_rotations(np.random.default_rng(2), 1)[0]
    moved = Surface.from_mesh(mesh.vertices @ rotation.T * 1e-3 + [1.0, 2.0, 3.0], mesh.faces)
    points = np.random.default_rng(0).uniform(-0.7, 0.7, (100, 3))
    assert moved.distance(points @ rotation.T) == pytest.approx(surface.distance(points), abs=1e-6)
    assert moved.radius == pytest.approx(surface.radius * 1e-3)


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.01])
@pytest.mark.parametrize("name", ["box", "ball", "thin wall"])
def test_roughness_is_the_noise_and_not_the_shape(name: str, noise: float) -> None:
    mesh = trimesh.creation.box((2.0, 2.0, 0.05)) if name == "thin wall" else BODIES[name].copy()
    while len(mesh.faces) < 6000:
        mesh = mesh.subdivide()
    radius = np.linalg.norm(mesh.vertices, axis=1).max()
    rough = mesh.vertices + np.random.default_rng(2).normal(0, noise * radius, mesh.vertices.shape)
    roughness = Surface.from_mesh(rough, mesh.faces).roughness
    assert 0.2 * noise <= roughness <= noise + 4e-4
