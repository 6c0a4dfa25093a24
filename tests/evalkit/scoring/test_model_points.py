"""ADD, ADD-S, MSSD and MSPD run over the mesh's own vertices, also where only gt.json is at hand."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from evalkit import GroundTruth, GroundTruthImage, InputError, PredictionImage, Predictions, average_precision
from evalkit.datasets.documents import read_ground_truth, write_ground_truth
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.meshes.load import load_object
from evalkit.objects.model import ObjectModel
from evalkit.scoring.distances import for_criterion

CRITERIA = ("add", "adds", "mssd", "mspd")
INTRINSICS = np.tile([600.0, 610.0, 320.0, 240.0, 640.0], (8, 1))


@pytest.fixture
def cone():
    mesh = trimesh.creation.cone(0.02, 0.07, sections=7)
    return ObjectModel.from_mesh("cone", mesh.vertices, mesh.faces)


@pytest.fixture
def written(cone, tmp_path):
    pose = poses.from_rotation_translation(np.eye(3), [[0.0, 0.0, 0.5]])
    image = GroundTruthImage("a", Camera(640, 480, 600.0, 600.0, 320.0, 240.0), pose, np.ones(1))
    write_ground_truth(tmp_path / "gt.json", GroundTruth(cone, [image]))
    return tmp_path / "gt.json"


def random_poses(seed):
    rng = np.random.default_rng(seed)
    return poses.from_rotation_translation(poses.random_rotations(rng, 8), rng.normal([0, 0, 0.5], 0.01, (8, 3)))


@pytest.mark.parametrize("criterion", CRITERIA)
def test_gt_json_alone_gives_the_distances_that_the_mesh_gives(cone, written, criterion):
    a, b = random_poses(0), random_poses(1)
    alone = for_criterion(criterion, read_ground_truth(written).object)(a, b, INTRINSICS)
    np.testing.assert_array_equal(alone, for_criterion(criterion, cone)(a, b, INTRINSICS))


def test_an_add_is_the_mean_over_vertices_and_not_over_the_surface(cone):
    a, b = random_poses(2), random_poses(3)
    motion = poses.apply(a, cone.vertices) - poses.apply(b, cone.vertices)
    np.testing.assert_allclose(for_criterion("add", cone)(a, b), np.linalg.norm(motion, axis=-1).mean(-1), rtol=1e-12)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_the_score_says_which_points_it_ran_over(written, criterion):
    truth = read_ground_truth(written)
    image = PredictionImage("a", truth.images[0].cam_from_obj, np.ones(1))
    result = average_precision(Predictions("cone", [image]), truth, criterion)
    assert f"the mesh's {len(truth.object.vertices)} vertices" in result.rules
    document = json.loads(written.read_text())
    document["object"].pop("vertices")  # as gt.json was before
    written.write_text(json.dumps(document))
    result = average_precision(Predictions("cone", [image]), read_ground_truth(written), criterion)
    assert "a sample of 1000 points" in result.rules
    assert result.ap == 1.0


@pytest.mark.parametrize("vertices", [[], [[1.0, 2.0]], [[0.0, 0.0, "x"]], [[0.0, 0.0, float("nan")]], 3])
def test_vertices_that_are_none_are_refused(written, vertices):
    document = json.loads(written.read_text())
    document["object"]["vertices"] = vertices
    written.write_text(json.dumps(document))
    with pytest.raises(InputError, match="vertices"):
        read_ground_truth(written)


def test_a_vertex_that_is_no_number_and_that_no_face_uses_counts_for_nothing(cone, tmp_path):
    torn = replace(cone, vertices=np.concatenate([cone.vertices, [[np.nan] * 3]]))
    a, b = random_poses(4), random_poses(5)
    for criterion in CRITERIA:
        expected = for_criterion(criterion, cone)(a, b, INTRINSICS)
        np.testing.assert_array_equal(for_criterion(criterion, torn)(a, b, INTRINSICS), expected)
    write_ground_truth(tmp_path / "gt.json", GroundTruth(torn, [GroundTruthImage("a", None, a, np.ones(8))]))
    np.testing.assert_array_equal(read_ground_truth(tmp_path / "gt.json").object.vertices, cone.vertices)


def test_a_corner_that_stl_repeats_for_every_facet_counts_once(tmp_path):
    mesh = trimesh.creation.cone(0.02, 0.07, sections=7)
    mesh.export(tmp_path / "cone.stl")
    mesh.export(tmp_path / "cone.ply")
    stl, ply = (load_object(tmp_path / f"cone.{kind}", "m", "none") for kind in ("stl", "ply"))
    assert len(stl.vertices) == len(ply.vertices) == len(mesh.vertices)
    assert stl.diameter == pytest.approx(ply.diameter, rel=1e-6)
    a, b = random_poses(6), random_poses(7)
    for criterion in CRITERIA:
        one, other = (for_criterion(criterion, model)(a, b, INTRINSICS) for model in (stl, ply))
        np.testing.assert_allclose(one, other, rtol=1e-5)
