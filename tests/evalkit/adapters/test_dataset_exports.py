"""Objects of every symmetry class, written in others' files and read back as the same objects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from evalkit.adapters.bop import export as bop_export
from evalkit.adapters.bop import object as bop_object
from evalkit.adapters.bop.mesh_frame import read_origin
from evalkit.adapters.sileane import dataset as sileane
from evalkit.adapters.sileane import export as sileane_export
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from evalkit.scoring.distances import Sym

CAMERA = Camera(64, 48, 70.0, 71.0, 31.5, 23.5)


@pytest.fixture(
    params=["none", "cyclic:2", "cyclic:5", "dihedral:3", "octahedral", "revolution", "revolution-flip", "sphere"]
)
def model(request, model_with_every_symmetry):
    return model_with_every_symmetry(request.param)


@pytest.fixture
def model_with_every_symmetry():
    """An object whose vertices are one orbit of its group, off the frame's origin, with the faces of their hull."""
    from scipy.spatial import ConvexHull

    from evalkit.objects.symmetry import Symmetry

    def make(name):
        rng = np.random.default_rng(3)
        symmetry = Symmetry.parse(name, poses.random_rotations(rng, 1)[0])
        seeds = rng.normal(0, 0.03, (5, 3))
        orbit = np.concatenate([seeds @ element.T for element in symmetry.elements(24)]) + np.array(
            [0.01, -0.02, 0.005]
        )
        hull = ConvexHull(orbit)
        return ObjectModel.from_mesh(name, orbit, hull.simplices, symmetry)

    return make


def assert_same_distances(back, model):
    """The Sym distance, which is all that a symmetry is for, is the same; and so is what counts as right."""
    rng = np.random.default_rng(0)
    rotation = poses.random_rotations(rng, 40)
    some = poses.from_rotation_translation(rotation, rng.normal(0, 0.1, (40, 3)) + np.array([0, 0, 1]))
    ours, theirs = (Sym(m)(some[:20], some[20:]) for m in (model, back))
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-6)


def test_bop_keeps_the_symmetry_about_the_centroid(model, tmp_path):
    bop_export.write_dataset_files(tmp_path, model, CAMERA, 1e-4)
    in_bop, _ = bop_object.read_object(tmp_path, 1)
    np.testing.assert_allclose(in_bop.box_center, 0.0, atol=1e-12)
    back = in_bop.with_origin(-read_origin(tmp_path / "models" / "models_info.json", 1))
    assert_same_distances(replace(back, lam=model.lam, inertial_from_obj=model.inertial_from_obj), model)
    np.testing.assert_allclose(back.centroid, model.centroid, atol=1e-6)


def test_sileane_keeps_the_symmetry_about_the_centroid(model, tmp_path):
    sileane_export.write_dataset_files(tmp_path, model, CAMERA, 1e-4, np.eye(4))
    back = sileane.read_object(tmp_path)
    assert_same_distances(back, model)
    assert back.threshold == pytest.approx(model.threshold, rel=1e-12)
    np.testing.assert_allclose(back.centroid, model.centroid, atol=1e-9)


def test_bops_diameter_is_the_largest_distance_of_two_vertices(model_with_every_symmetry, tmp_path):
    model = model_with_every_symmetry("cyclic:5")
    bop_export.write_dataset_files(tmp_path, model, CAMERA, 1e-4)
    back, _ = bop_object.read_object(tmp_path, 1)
    apart = np.linalg.norm(model.vertices[:, None] - model.vertices, axis=-1).max()
    assert back.threshold == pytest.approx(0.1 * apart, rel=1e-9)


def test_quaternions_go_there_and_back_with_their_sign_settled():
    rotation = poses.random_rotations(np.random.default_rng(0), 50)
    quaternion = poses.to_quaternion_xyzw(rotation)
    assert (quaternion[:, 3] >= 0).all()
    np.testing.assert_allclose(poses.from_quaternion_xyzw(quaternion), rotation, atol=1e-12)
