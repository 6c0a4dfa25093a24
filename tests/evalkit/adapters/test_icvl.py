"""The ICVL adapter: OpenGL's axes to OpenCV's, visibility never assumed in silence."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from evalkit import InputError, average_precision
from evalkit.adapters import icvl
from evalkit.adapters.visibility import seen_in_depth
from evalkit.commands.cli import main
from evalkit.datasets.documents import read_ground_truth, read_predictions
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel

CV_FROM_GL = np.diag([1.0, -1.0, -1.0])
SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.05
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def write_matrix(path, rotation, translation, below=""):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
    path.write_text("\n".join(" ".join(f"{x:.6f}" for x in row) for row in matrix) + f"\n{below}")


def write_scene(folder, instances=2, images=(0, 12), depth_mm=1000):
    folder.mkdir(parents=True)
    rng = np.random.default_rng(3)
    for image in images:
        write_matrix(folder / f"camera_pose_{image}.txt", np.eye(3), [0, 0, 0])
        for k in range(1, instances + 1):
            write_matrix(
                folder / f"coffee_cup{k}_{image}.txt", poses.random_rotations(rng, 1)[0], [0.1 * k, 0.05, -0.8]
            )
        cv2.imwrite(str(folder / f"depth{image}.png"), np.full((480, 640), depth_mm, np.uint16))
    return folder


@pytest.fixture
def mesh(tmp_path):
    path = tmp_path / "square.obj"
    lines = [f"v {x} {y} {z}" for x, y, z in SQUARE] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]
    path.write_text("\n".join(lines))
    return {"mesh": path, "units": "m", "symmetry": "none"}


def test_what_opengl_sees_ahead_and_above_is_ahead_and_above(tmp_path, mesh):
    scene = write_scene(tmp_path / "test" / "01")
    truth = icvl.read_ground_truth(tmp_path / "test", visibility="full", **mesh)
    assert [image.id for image in truth.images] == ["000001-000000", "000001-000012"]
    for image, number in zip(truth.images, (0, 12), strict=True):
        for k, cam_from_obj in enumerate(image.cam_from_obj, 1):
            in_gl = np.loadtxt(scene / f"coffee_cup{k}_{number}.txt")
            np.testing.assert_allclose(
                poses.apply(cam_from_obj, SQUARE), poses.apply(in_gl, SQUARE) @ CV_FROM_GL, atol=1e-12
            )
    assert (truth.images[0].cam_from_obj[:, 2, 3] > 0).all()
    assert (
        truth.images[0].camera.project(truth.images[0].cam_from_obj[:, :3, 3])[:, 1] < 244
    ).all()  # above the middle
    assert truth.object.name == "coffee_cup"


def test_instances_are_in_the_order_of_their_numbers(tmp_path, mesh):
    write_scene(tmp_path / "test" / "01", instances=11, images=(0,))
    truth = icvl.read_ground_truth(tmp_path / "test" / "01", visibility="full", **mesh)
    np.testing.assert_allclose(truth.images[0].cam_from_obj[:, 0, 3], 0.1 * np.arange(1, 12))


def test_objects_are_chosen_by_name_and_images_without_them_stay(tmp_path, mesh):
    scene = write_scene(tmp_path / "test" / "03")
    write_matrix(scene / "juice1_12.txt", np.eye(3), [0, 0, -0.7])
    with pytest.raises(InputError, match="--object with one of coffee_cup, juice"):
        icvl.read_ground_truth(tmp_path / "test", visibility="full", **mesh)
    truth = icvl.read_ground_truth(tmp_path / "test", object_name="juice", visibility="full", **mesh)
    assert [len(image.visibility) for image in truth.images] == [0, 1]


def test_visibility_and_mesh_are_asked_for(tmp_path, mesh):
    write_scene(tmp_path / "test" / "01")
    with pytest.raises(InputError, match="--visibility depth"):
        icvl.read_ground_truth(tmp_path / "test", **mesh)
    with pytest.raises(InputError, match="--mesh and --units"):
        icvl.read_ground_truth(tmp_path / "test", visibility="full")
    with pytest.raises(InputError, match="--visibility most"):
        icvl.read_ground_truth(tmp_path / "test", visibility="most", **mesh)


@pytest.mark.parametrize(
    ("depth_mm", "geometric", "returned"), [(1000, 1.0, 1.0), (808, 1.0, 1.0), (700, 0.0, 0.0), (0, 1.0, 0.0)]
)
def test_both_shares_are_read_off_the_depth_images(tmp_path, mesh, depth_mm, geometric, returned):
    scene = write_scene(tmp_path / "test" / "01", instances=0, images=(5,), depth_mm=depth_mm)
    write_matrix(scene / "coffee_cup1_5.txt", np.eye(3), [0, 0, -0.81])
    for word, first, other in (("depth", geometric, returned), ("returned", returned, geometric)):
        truth = icvl.read_ground_truth(tmp_path / "test", visibility=word, **mesh)
        assert truth.share == ("returned" if word == "returned" else "geometric")
        assert truth.images[0].visibility.tolist() == [first]
        assert truth.images[0].other_visibility.tolist() == [other]
        assert any("estimated from the depth images" in remark for remark in truth.remarks)


CAMERA = Camera(200, 160, 400.0, 400.0, 99.5, 79.5)


def seen(*translations):
    cam_from_obj = poses.from_rotation_translation(np.eye(3), np.array(translations))
    model = ObjectModel.from_mesh("square", SQUARE, FACES)
    return seen_in_depth(np.full((160, 200), 2.0), CAMERA, model, cam_from_obj)[0]


def test_instances_hide_each_other_however_close_they_lie():
    np.testing.assert_allclose(seen([0, 0, 0.5], [0.05, 0, 0.502]), [1.0, 0.5], atol=0.03)
    np.testing.assert_allclose(seen([0, 0, 0.5], [0, 0, 1.0]), [1.0, 0.0], atol=0.01)


def test_the_part_beyond_the_frame_counts_as_hidden():
    edge = 100 / 400 * 0.5  # the frame's right side at half a meter
    np.testing.assert_allclose(seen([edge, 0, 0.5], [-0.05, 0, 0.5]), [0.5, 1.0], atol=0.03)
    assert seen([3.0, 0, 0.5]).tolist() == [0.0]


@pytest.mark.parametrize("offset", [(0, 0, 1.0), (0, 0, -1.0), (3.0, -2.0, 3.0)])
def test_visibility_does_not_depend_on_the_files_origin(offset):
    vertices = np.concatenate([SQUARE, SQUARE + np.array([0, 0, 0.03])])
    faces = np.concatenate([FACES, FACES + len(SQUARE)])
    rotation = poses.from_axis_angle([1.0, 0, 0], np.array([2.8, -0.4]))
    depth = np.full((160, 200), 2.0)
    depth[:, :80] = 0.3
    shares = [
        seen_in_depth(
            depth,
            CAMERA,
            ObjectModel.from_mesh("squares", vertices + shift, faces),
            poses.from_rotation_translation(rotation, [[-0.02, 0, 0.6], [0.08, 0, 0.6]] - rotation @ shift),
        )[0]
        for shift in (np.zeros(3), np.array(offset))
    ]
    assert 0.1 < shares[0][0] < 0.9
    np.testing.assert_allclose(shares[1], shares[0], atol=0.01)


def test_a_depth_image_of_another_size_and_an_object_behind_the_camera_are_refused():
    model = ObjectModel.from_mesh("square", SQUARE, FACES)
    with pytest.raises(InputError, match="20x10"):
        seen_in_depth(np.ones((10, 20)), CAMERA, model, np.eye(4)[None])
    with pytest.raises(InputError, match="too near"):
        seen([0, 0, -0.5])


def test_results_are_read_with_the_score_below_the_matrix(tmp_path, mesh):
    scene = write_scene(tmp_path / "test" / "01", images=(0,))
    truth = icvl.read_ground_truth(tmp_path / "test", visibility="full", **mesh)
    results = tmp_path / "results" / "01"
    results.mkdir(parents=True)
    for k in (1, 2):
        (results / f"coffee_cup{k}_0.txt").write_text((scene / f"coffee_cup{k}_0.txt").read_text() + f"{k / 10}\n")
    predictions = icvl.read_predictions(tmp_path / "results")
    assert predictions.images[0].score.tolist() == [0.1, 0.2]
    assert average_precision(predictions, truth).ap == 1.0
    with pytest.raises(InputError, match=r"coffee_cup1_0\.txt.*score"):
        icvl.read_predictions(tmp_path / "test")


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n", "4x4"),
        ("1 0 0 0\n0 1 0 0\n0 0 1 x\n0 0 0 1\n", "4x4"),
        ("1 0 0 0\n0 1 0 0\n0 0 1 nan\n0 0 0 1\n", "finite"),
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 -0.8 1\n", "last row"),
        ("2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1\n", "rotation"),
        ("1 0 0 0\n0 1 0 0\n0 0 -1 0\n0 0 0 1\n", "rotation"),
        ("1 0 0 0\n0 1 0 0\n0 0 1 -800\n0 0 0 1\n", "unit"),
    ],
)
def test_a_pose_that_cannot_be_read_is_refused_by_file(tmp_path, mesh, text, word):
    scene = write_scene(tmp_path / "test" / "01")
    (scene / "coffee_cup2_12.txt").write_text(text)
    with pytest.raises(InputError, match=rf"coffee_cup2_12\.txt.*{word}"):
        icvl.read_ground_truth(tmp_path / "test", visibility="full", **mesh)


def test_depth_images_are_millimeters(tmp_path):
    write_scene(tmp_path / "test" / "01", depth_mm=731)
    images = list(icvl.depth_images(tmp_path / "test"))
    assert [image.id for image in images] == ["000001-000000", "000001-000012"]
    np.testing.assert_allclose(images[0].read(), 0.731)


def test_missing_depth_and_folders_are_named(tmp_path, mesh):
    scene = write_scene(tmp_path / "test" / "01")
    (scene / "depth12.png").unlink()
    with pytest.raises(InputError, match=r"depth12\.png"):
        icvl.read_ground_truth(tmp_path / "test", visibility="depth", **mesh)
    with pytest.raises(InputError, match=r"coffee_cup1_0\.txt"):
        icvl.read_ground_truth(tmp_path, visibility="full", **mesh)
    with pytest.raises(InputError, match="nowhere"):
        icvl.read_ground_truth(tmp_path / "nowhere", visibility="full", **mesh)


def test_the_command_says_what_visibility_rests_on(tmp_path, mesh):
    write_scene(tmp_path / "test" / "01")
    arguments = [
        "gt",
        tmp_path / "test",
        "--from",
        "icvl",
        "--mesh",
        mesh["mesh"],
        "--units",
        "m",
        "--symmetry",
        "none",
    ]
    arguments += ["--visibility", "full", "-o", tmp_path / "gt.json"]
    done = CliRunner().invoke(main, list(map(str, arguments)), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert "Note: Visibility is not known" in done.output
    truth = read_ground_truth(tmp_path / "gt.json")
    images = [
        {
            "id": image.id,
            "hypotheses": [{"R": p[:3, :3].tolist(), "t": p[:3, 3].tolist(), "score": 1.0} for p in poses_],
        }
        for image, poses_ in ((image, image.cam_from_obj) for image in truth.images)
    ]
    document = {"format": "binpose-preds/1", "object": "coffee_cup", "images": images}
    (tmp_path / "preds.json").write_text(json.dumps(document))
    assert average_precision(read_predictions(tmp_path / "preds.json"), truth).ap == 1.0
