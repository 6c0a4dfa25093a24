"""The Siléane adapter: the authors' own figures on their own data, and a hand-made folder of every kind."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from evalkit import InputError, PredictionImage, Predictions, average_precision
from evalkit.adapters.sileane import dataset as sileane
from evalkit.datasets import documents
from evalkit.geometry import poses
from evalkit.meshes.read import read_mesh
from evalkit.objects.model import surface_moments
from evalkit.scoring.distances import Sym, SymToolbox

GOLDEN = [  # min visibility, max results, threshold factor: AP, MAP, best F1, recall at precision 0.99
    (0.5, None, 1.0, 0.842203548086, 0.842203548086, 0.914343639128, 0.842203548086),
    (0.5, None, 0.25, 0.798411235339, 0.800051872601, 0.873938422620, 0.657485216309),
    (0.5, None, 0.1, 0.556925226564, 0.557557305923, 0.665398117828, 0.273731714908),
    (0.7, None, 1.0, 1.0, 1.0, 1.0, 1.0),
    (-0.1, None, 1.0, 0.197076905880, 0.197076905880, 0.329263566796, 0.197076905880),
    (0.5, 5, 1.0, 1.0, 1.0, 1.0, 1.0),
]


@pytest.mark.parametrize("in_camera", [True, False])
@pytest.mark.parametrize("row", GOLDEN)
def test_the_toolbox_mode_gives_the_figures_of_the_authors_toolbox(reference, tmp_path, row, in_camera):
    folder = reference / "sileane_bunny"
    if not in_camera:
        for name in ("gt", "results", "poseutils.json"):
            (tmp_path / name).symlink_to(folder / name)
        folder = tmp_path
    truth = sileane.read_ground_truth(folder)
    predictions = sileane.read_predictions(folder / "results")
    assert truth.frame == predictions.frame == ("camera" if in_camera else "world")
    min_visibility, max_results, factor, *expected = row
    result = average_precision(
        predictions,
        truth,
        protocol="sileane-toolbox",
        min_visibility=min_visibility,
        max_results=max_results,
        threshold=0.1 * factor,
    )
    figures = [result.ap, result.map, result.best_f1, result.recall_at_precision_99]
    np.testing.assert_allclose(figures, expected, rtol=0, atol=1e-9)


def test_the_objects_published_moments_are_those_of_its_mesh(reference):
    model = sileane.read_object(reference / "sileane_bunny")
    _, centroid, covariance = surface_moments(model.vertices, model.faces)
    np.testing.assert_allclose(model.centroid, centroid, atol=1e-4)  # the mesh is simplified
    np.testing.assert_allclose(model.lam_in_obj @ model.lam_in_obj, covariance, atol=1e-6)
    assert model.diameter == pytest.approx(
        2 * np.linalg.norm(model.vertices[np.unique(model.faces)] - centroid, axis=1).max(), rel=1e-2
    )


def test_the_toolbox_distance_differs_from_the_right_one_by_millimeters(reference):
    model = sileane.read_object(reference / "sileane_bunny")
    rng = np.random.default_rng(0)
    at_origin = np.zeros((1000, 3))
    a, b = (poses.from_rotation_translation(poses.random_rotations(rng, 1000), at_origin) for _ in range(2))
    difference = np.abs(Sym(model)(a, b) - SymToolbox(model)(a, b))
    assert 0.5e-3 < difference.max() < 3e-3


def folder_with(tmp_path, **pose_utils):
    """A folder as the dataset has it, with two instances in one scene, and results."""
    turn = poses.from_axis_angle([1.0, 2.0, 0.5], 0.4)
    document = {
        "type": "AffinePoseUtils",
        "Lambda": np.diag([0.01, 0.02, 0.03]).tolist(),
        "G": [np.eye(3).tolist(), np.diag([-1.0, -1.0, 1.0]).tolist()],
        "Rref2i": np.round(turn, 6).tolist(),
        "tref2i": [[0.001], [0.002], [0.003]],
        "distance_threshold": 0.01,
    }
    document = {key: value for key, value in (document | pose_utils).items() if value is not None}
    folder = tmp_path / "thing"
    for name in ("gt", "results"):
        (folder / name).mkdir(parents=True)
    (folder / "poseutils.json").write_text(json.dumps(document))
    rows = [{"R": np.eye(3).tolist(), "t": [0.1, 0.2, 0.3], "occlusion_rate": 0.25, "segmentation_id": 1}]
    rows.append({"R": turn.tolist(), "t": [-0.1, 0.2, 0.3], "occlusion_rate": 0.75, "segmentation_id": 2})
    (folder / "gt" / "scene_1.json").write_text(json.dumps(rows))
    results = [{"R": row["R"], "t": row["t"], "score": score} for row, score in zip(rows, (10, 20), strict=True)]
    (folder / "results" / "scene_1.json").write_text(json.dumps(results))
    return folder


def write_camera(folder, **changes):
    fields = {
        "width": "640", "height": "480", "fu": "1000", "fv": "1001", "cu": "320", "cv": "240", "clip_start": "0.8",
        "location": "0 0 2", "rotation": "0 1 0 0",
    }  # fmt: skip
    fields.update(changes)
    (folder / "camera_params.txt").write_text("\n".join(f"{key}\t{value}" for key, value in fields.items()))


def test_without_a_camera_poses_stay_in_the_world(tmp_path):
    folder = folder_with(tmp_path)
    truth, predictions = sileane.read_ground_truth(folder), sileane.read_predictions(folder / "results")
    assert (truth.frame, truth.object.name, truth.images[0].id) == ("world", "", "scene_1")
    assert truth.images[0].cam_from_obj[0, :3, 3].tolist() == [0.1, 0.2, 0.3]
    assert truth.images[0].visibility.tolist() == [0.75, 0.25]
    assert average_precision(predictions, truth).counts["true"] == 1


def test_a_name_that_nobody_stated_is_no_reason_to_refuse(tmp_path):
    """Siléane's files name no object, so a folder's name does not stand for one: the diameter decides."""
    folder = folder_with(tmp_path)
    documents.write_ground_truth(tmp_path / "gt.json", sileane.read_ground_truth(folder))
    (tmp_path / "elsewhere").mkdir()
    (folder / "results").rename(tmp_path / "elsewhere" / "experiments")
    found = sileane.read_predictions(tmp_path / "elsewhere" / "experiments")
    documents.write_predictions(tmp_path / "preds.json", found)
    truth = documents.read_ground_truth(tmp_path / "gt.json")
    nameless = documents.read_predictions(tmp_path / "preds.json")
    assert (truth.object.name, nameless.object_name) == ("", "")
    for reference in (nameless.object, "bunny", {"name": "bunny", "diameter": truth.object.diameter}):
        assert average_precision(replace(nameless, object=reference), truth).counts["true"] == 1
    with pytest.raises(InputError, match="diameter"):
        average_precision(replace(nameless, object={"diameter": 2 * truth.object.diameter}), truth)
    named = replace(truth, object=replace(truth.object, name="gear"))
    with pytest.raises(InputError, match=r"'bunny'.*'gear'"):
        average_precision(replace(nameless, object="bunny"), named)


def test_with_a_camera_poses_are_the_cameras(tmp_path):
    folder = folder_with(tmp_path)
    write_camera(folder)
    image = sileane.read_ground_truth(folder).images[0]
    assert (image.camera.width, image.camera.fy, image.camera.cx) == (640, 1001, 320)
    np.testing.assert_allclose(image.cam_from_obj[0, :3, 3], [0.1, -0.2, 1.7])  # it looks down from 2 m


def test_frames_are_never_mixed(tmp_path):
    folder = folder_with(tmp_path)
    predictions = sileane.read_predictions(folder / "results")
    write_camera(folder)
    with pytest.raises(InputError, match="frame"):
        average_precision(predictions, sileane.read_ground_truth(folder))


def test_symmetries_are_turned_into_the_objects_frame(tmp_path):
    model = sileane.read_object(folder_with(tmp_path))
    in_inertial = model.symmetry.rotated(model.inertial_from_obj[:3, :3])
    np.testing.assert_allclose(in_inertial.rotations[1], np.diag([-1.0, -1.0, 1.0]), atol=1e-6)
    # A turn of half a revolution about that axis, through the centroid, is no motion.
    turn = model.symmetry.rotations[1]
    turned = poses.from_rotation_translation(turn, model.centroid - turn @ model.centroid)
    assert Sym(model)(turned[None], np.eye(4)[None])[0] < 1e-9


@pytest.mark.parametrize(
    ("pose_utils", "name"),
    [
        ({"type": "RevolutionPoseUtils", "lambda": 0.05, "isFlip": False}, "revolution"),
        ({"type": "RevolutionPoseUtils", "lambda": 0.05, "isFlip": True}, "revolution-flip"),
        ({"type": "SphericalPoseUtils"}, "sphere"),
        ({"G": [np.eye(3).tolist()]}, "none"),
    ],
)
def test_every_kind_of_symmetry_is_read(tmp_path, pose_utils, name):
    model = sileane.read_object(folder_with(tmp_path, **pose_utils))
    assert model.symmetry.name == name
    if name.startswith("revolution"):
        assert model.symmetry.revolution_scale(model.lam_in_obj) == pytest.approx(0.05)
        np.testing.assert_allclose(model.inertial_from_obj[:3, :3] @ model.symmetry.axis, [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("pose_utils", "word"),
    [
        ({"type": "MoebiusPoseUtils", "G": None}, "MoebiusPoseUtils"),
        ({"type": "RevolutionPoseUtils", "lambda": 0.05}, "isFlip"),
        ({"type": "AffinePoseUtils", "G": 3}, "'G'"),
        ({"G": [np.eye(3).tolist(), np.diag([1.0, -1.0, 1.0]).tolist()]}, "'G'"),
        ({"Rref2i": (2 * np.eye(3)).tolist()}, "Rref2i"),
        ({"tref2i": [1, 2]}, "tref2i"),
        ({"Lambda": "big"}, "Lambda"),
        ({"distance_threshold": float("nan")}, "distance_threshold"),
        ({"distance_threshold": -1}, "distance_threshold"),
    ],
)
def test_what_is_not_known_is_refused_by_name(tmp_path, pose_utils, word):
    with pytest.raises(InputError, match=word) as caught:
        sileane.read_object(folder_with(tmp_path, **pose_utils))
    assert "poseutils.json" in str(caught.value)


@pytest.mark.parametrize("change", [{"rotation": "0 0 0 0"}, {"location": "1 2"}, {"fu": "wide"}])
def test_a_camera_that_cannot_be_read_is_refused_by_line(tmp_path, change):
    folder = folder_with(tmp_path)
    write_camera(folder, **change)
    with pytest.raises(InputError, match=f"camera_params.txt.*'{next(iter(change))}'"):
        sileane.read_ground_truth(folder)


def test_a_folder_without_scenes_is_refused(tmp_path):
    with pytest.raises(InputError, match="no scene files"):
        sileane.read_predictions(tmp_path)


def test_an_obj_file_with_polygons_and_negative_indices_is_read(tmp_path):
    path = tmp_path / "mesh.obj"
    path.write_text("# quad\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1 4//1\nf -4 -3 -2\n")
    vertices, faces = read_mesh(path)
    assert vertices.shape == (4, 3)
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]


def test_predictions_go_out_and_come_back(tmp_path):
    folder = folder_with(tmp_path)
    write_camera(folder, rotation="0.1 0.9 0.3 -0.2999", location="0.1 0.2 1.5")
    predictions = sileane.read_predictions(folder / "results")
    sileane.write_predictions(folder / "again", predictions, folder / "camera_params.txt")
    again = sileane.read_predictions(folder / "again")
    assert [image.id for image in again.images] == ["scene_1"]
    np.testing.assert_allclose(again.images[0].cam_from_obj, predictions.images[0].cam_from_obj, atol=1e-12)
    assert again.images[0].score.tolist() == [10, 20]


def test_without_a_camera_predictions_go_out_as_they_are_and_say_so(tmp_path):
    predictions = sileane.read_predictions(folder_with(tmp_path) / "results")
    assert sileane.write_predictions(tmp_path / "world", predictions) is None
    in_camera = replace(predictions, frame="camera")
    assert "--camera-params" in sileane.write_predictions(tmp_path / "camera", in_camera)
    for name in ("world", "camera"):
        rows = json.loads((tmp_path / name / "scene_1.json").read_text())
        np.testing.assert_array_equal([row["t"] for row in rows], predictions.images[0].cam_from_obj[:, :3, 3])


def test_an_image_id_that_leaves_the_folder_is_refused(tmp_path):
    image = PredictionImage("../away", np.eye(4)[None], np.ones(1))
    with pytest.raises(InputError, match=r"\.\./away"):
        sileane.write_predictions(tmp_path / "out", Predictions("thing", [image]))
    assert not (tmp_path / "away.json").exists()
