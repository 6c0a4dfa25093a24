"""What is derived from a mesh obeys the laws of moments, and survives JSON."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel, sample_surface, sample_surface_with_normals, surface_moments
from evalkit.objects.symmetry import Symmetry

BODY = trimesh.convex.convex_hull(np.random.default_rng(4).normal(size=(40, 3)) * [1.0, 2.0, 3.0] + [5, 0, 0])
V, F = np.array(BODY.vertices), np.array(BODY.faces)


def test_moments_are_those_of_the_surface() -> None:
    """Against a rule exact for quadratic functions: the middles of each triangle's sides."""
    area, centroid, covariance = surface_moments(V, F)
    corners = V[F]
    middles = ((corners + corners[:, [1, 2, 0]]) / 2).reshape(-1, 3)
    weights = np.repeat(BODY.area_faces, 3)
    assert area == pytest.approx(BODY.area)
    assert centroid == pytest.approx(np.average(middles, axis=0, weights=weights))
    assert covariance == pytest.approx(np.cov(middles.T, aweights=weights, ddof=0))


def test_moments_do_not_depend_on_how_the_surface_is_cut() -> None:
    fine = BODY.subdivide()
    for coarse_moment, fine_moment in zip(
        surface_moments(V, F), surface_moments(fine.vertices, fine.faces), strict=True
    ):
        assert fine_moment == pytest.approx(coarse_moment)


@pytest.mark.parametrize("seed", range(3))
def test_moments_move_with_the_body(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rotation, shift, size = poses.random_rotations(rng, 1)[0], rng.normal(size=3), 2.5
    area, centroid, covariance = surface_moments(V, F)
    moved = surface_moments(V @ rotation.T * size + shift, F)
    assert moved[0] == pytest.approx(area * size**2)
    assert moved[1] == pytest.approx(rotation @ centroid * size + shift)
    assert moved[2] == pytest.approx(rotation @ covariance @ rotation.T * size**2)


def test_samples_lie_on_the_surface_evenly_with_its_normals() -> None:
    points, normals = sample_surface_with_normals(V, F, 4000)
    assert np.array_equal(points, sample_surface(V, F, 4000))
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(4000))
    plane = BODY.facets_normal if len(BODY.facets) == len(F) else BODY.face_normals
    offset = np.einsum("fi,fi->f", plane, BODY.triangles[:, 0])
    assert (points @ plane.T - offset).max(1) == pytest.approx(np.zeros(4000), abs=1e-9)
    _, centroid, covariance = surface_moments(V, F)
    assert points.mean(0) == pytest.approx(centroid, abs=0.05)
    assert np.cov(points.T) == pytest.approx(covariance, abs=0.15)


def test_the_inertial_frame_is_where_lambda_is_diagonal() -> None:
    model = ObjectModel.from_mesh("body", V, F)
    _, _, covariance = surface_moments(poses.apply(model.inertial_from_obj, V), F)
    assert covariance == pytest.approx(model.lam @ model.lam)
    assert model.lam == pytest.approx(np.diag(np.diag(model.lam)))
    assert model.lam_in_obj @ model.lam_in_obj == pytest.approx(surface_moments(V, F)[2])
    assert poses.apply(model.inertial_from_obj, model.centroid[None]) == pytest.approx(np.zeros((1, 3)))


def test_the_diameter_is_that_of_the_sphere_about_the_centroid_and_strays_do_not_count() -> None:
    model = ObjectModel.from_mesh("body", np.concatenate([V, [[1e6, 0, 0]]]), F)
    assert model.diameter == pytest.approx(2 * np.linalg.norm(V - model.centroid, axis=1).max())
    assert model.threshold == pytest.approx(model.diameter / 10)


def test_centers_follow_the_poses() -> None:
    model = ObjectModel.from_mesh("body", V, F)
    rng = np.random.default_rng(0)
    pose = poses.from_rotation_translation(
        poses.random_rotations(rng, 6).reshape(2, 3, 3, 3), rng.normal(size=(2, 3, 3))
    )
    centers = model.centers(pose)
    assert centers.shape == (2, 3, 3)
    assert centers[1, 2] == pytest.approx((pose[1, 2] @ [*model.centroid, 1])[:3])


@pytest.mark.parametrize("name", ["none", "cyclic:3", "revolution-flip", "sphere"])
def test_json_keeps_all_but_the_mesh(name: str) -> None:
    model = ObjectModel.from_mesh("body", V, F, Symmetry.parse(name), source="body.stl")
    again = ObjectModel.from_json(json.loads(json.dumps(model.to_json())))
    pose = poses.from_rotation_translation(poses.random_rotations(np.random.default_rng(0), 4), np.ones((4, 3)))
    assert again.representatives(pose) == pytest.approx(model.representatives(pose))
    assert again.points == pytest.approx(model.points, abs=1e-8)
    assert (again.name, again.notes, again.vertices) == ("body", {"source": "body.stl"}, None)
    assert (again.diameter, again.threshold) == (model.diameter, model.threshold)


GOOD = ObjectModel.from_mesh("body", V, F).to_json()
DAMAGES = [
    ("diameter", None), ("diameter", -1.0), ("diameter", "large"), ("threshold", 0), ("centroid", [0, 0]),
    ("centroid", [0, 0, float("nan")]), ("lambda", [[1]]), ("inertial_from_obj", (2 * np.eye(4)).tolist()),
    ("points", [[1, 2]]), ("symmetry", {"name": "round"}), ("symmetry", None),
]  # fmt: skip


@pytest.mark.parametrize(("field", "value"), DAMAGES, ids=str)
def test_a_damaged_document_is_refused_by_place(field: str, value: object) -> None:
    with pytest.raises(InputError, match=r"gt\.json"):
        ObjectModel.from_json({**GOOD, field: value}, "gt.json")


@pytest.mark.parametrize("field", ["diameter", "threshold", "centroid", "lambda", "inertial_from_obj", "symmetry"])
def test_a_missing_field_is_named(field: str) -> None:
    with pytest.raises(InputError, match=r"gt\.json"):
        ObjectModel.from_json({k: v for k, v in GOOD.items() if k != field}, "gt.json")


def test_a_mesh_without_area_is_refused() -> None:
    with pytest.raises(InputError, match="no surface area"):
        ObjectModel.from_mesh("line", np.eye(3), [[0, 1, 1]])


def test_the_reference_bunny_has_the_published_geometry(reference: Path) -> None:
    """Diameter of the sphere about the centroid: 10 times the toolbox's distance_threshold of 0.0234355."""
    mesh = trimesh.load_mesh(reference / "sileane_bunny" / "mesh.obj")
    model = ObjectModel.from_mesh("bunny", mesh.vertices, mesh.faces)
    assert model.threshold == pytest.approx(0.0234355, abs=1e-7)
