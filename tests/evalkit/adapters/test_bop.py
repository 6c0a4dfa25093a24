"""The BOP adapters: millimeters to meters, stated symmetries kept exactly, results both ways."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from evalkit import InputError, average_precision
from evalkit.adapters.bop import dataset as bop
from evalkit.adapters.bop import results as bop_results
from evalkit.adapters.bop.object import symmetry_group
from evalkit.adapters.bop.target_lists import read_targets
from evalkit.adapters.depth_images import write_depth_images
from evalkit.commands.cli import main
from evalkit.datasets.documents import PredictionImage, Predictions, read_ground_truth, read_predictions
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.scoring.distances import Sym

SIZE = np.array([60.0, 60.0, 100.0])  # millimeters
CENTER = np.array([3.0, -2.0, 5.0])  # of the box in its own frame, so that symmetries need translations
K = [600.0, 0.0, 39.5, 0.0, 610.0, 29.0, 0.0, 0.0, 1.0]


def write_box(path, center=CENTER):
    corners = center + SIZE * (np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) - 0.5)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    lines = ["ply", "format ascii 1.0", "element vertex 8", *(f"property float {axis}" for axis in "xyz")]
    lines += ["element face 6", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(map(str, corner)) for corner in corners] + ["4 " + " ".join(map(str, quad)) for quad in quads]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines))


def about(rotation, center=CENTER):
    """The 4x4 motion in millimeters that turns about `center`."""
    return poses.from_rotation_translation(rotation, center - rotation @ center)


def turn(axis, degrees):
    return poses.from_axis_angle(axis, np.radians(degrees))


def write_dataset(root, symmetries=None, scenes=(1,), sensor=""):
    """Two images a scene; in image 3 two instances of object 1 and one of object 2, in image 4 object 2 only."""
    write_box(root / "models" / "obj_000001.ply")
    write_box(root / "models" / "obj_000002.ply", np.zeros(3))
    low = CENTER - SIZE / 2
    info = {"diameter": float(np.linalg.norm(SIZE)), **dict(zip(("min_x", "min_y", "min_z"), low, strict=True))}
    info |= dict(zip(("size_x", "size_y", "size_z"), SIZE, strict=True)) | (symmetries or {})
    (root / "models" / "models_info.json").write_text(json.dumps({"1": info, "2": {"diameter": 131.0}}))
    rng = np.random.default_rng(0)
    for scene in scenes:
        folder = root / "test" / f"{scene:06d}"
        (folder / f"depth{sensor}").mkdir(parents=True)
        rows = [
            {"cam_R_m2c": rotation.ravel().tolist(), "cam_t_m2c": [x, 5.0 * scene, 900.0], "obj_id": obj}
            for rotation, x, obj in zip(poses.random_rotations(rng, 3), (-80.0, 0.0, 90.0), (1, 2, 1), strict=True)
        ]
        cameras = {image: {"cam_K": K, "depth_scale": 0.5} for image in ("3", "4")}
        seen = [{"visib_fract": share} for share in (0.9, 0.8, 0.25)]
        for name, document in (
            ("scene_gt", {"3": rows, "4": [rows[1]]}),
            ("scene_gt_info", {"3": seen, "4": [seen[1]]}),
            ("scene_camera", cameras),
        ):
            (folder / f"{name}{sensor}.json").write_text(json.dumps(document))
        for image in (3, 4):
            depth = np.full((60, 80), 2000, np.uint16)  # 1 m at half a millimeter a step
            cv2.imwrite(str(folder / f"depth{sensor}" / f"{image:06d}.png"), depth)
    return root / "test"


@pytest.fixture
def split(tmp_path):
    return write_dataset(tmp_path / "set")


def edit(path, change):
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def test_poses_project_where_bops_own_formula_puts_them(split):
    truth = bop.read_ground_truth(split, object_id=1)
    rows = json.loads((split / "000001" / "scene_gt.json").read_text())["3"]
    image = truth.images[0]
    assert (image.camera.width, image.camera.height) == (80, 60)
    for row, cam_from_obj in zip((rows[0], rows[2]), image.cam_from_obj, strict=True):
        millimeters = 1000 * truth.object.vertices
        rotation, translation = np.reshape(row["cam_R_m2c"], (3, 3)), np.array(row["cam_t_m2c"])
        u, v, w = np.reshape(K, (3, 3)) @ (rotation @ millimeters.T + translation[:, None])
        ours = image.camera.project(poses.apply(cam_from_obj, truth.object.vertices))
        np.testing.assert_allclose(ours, np.stack([u / w, v / w], -1), atol=1e-9)


def test_a_part_whose_files_origin_is_at_the_camera_is_read(split):
    path = split.parent / "models" / "obj_000001.ply"
    write_box(path, np.array([0.0, 0.0, 900.0]))
    (path.parent / "models_info.json").write_text(json.dumps({"1": {}, "2": {"diameter": 131.0}}))
    edit(split / "000001" / "scene_gt.json", lambda d: d["3"][2].update(cam_R_m2c=np.eye(3).ravel().tolist()))
    edit(split / "000001" / "scene_gt.json", lambda d: d["3"][2].update(cam_t_m2c=[0.0, 0.0, 0.0]))
    truth = bop.read_ground_truth(split, object_id=1)
    assert truth.object.centers(truth.images[0].cam_from_obj)[1] == pytest.approx([0, 0, 0.9])


def test_images_without_the_object_stay_and_visibility_follows_its_instance(split):
    truth = bop.read_ground_truth(split, object_id=1)
    assert [image.id for image in truth.images] == ["000001-000003", "000001-000004"]
    assert [image.visibility.tolist() for image in truth.images] == [[0.9, 0.25], []]
    assert truth.object.name == "obj_000001"
    assert truth.object.threshold == pytest.approx(0.1 * np.linalg.norm(SIZE) / 1000)


def test_a_split_is_the_sum_of_its_scenes(tmp_path):
    split = write_dataset(tmp_path / "set", scenes=(1, 7))
    whole = bop.read_ground_truth(split, object_id=1)
    parts = [bop.read_ground_truth(split / name, object_id=1) for name in ("000001", "000007")]
    assert [image.id for image in whole.images] == [image.id for part in parts for image in part.images]
    np.testing.assert_array_equal(whole.images[2].cam_from_obj, parts[1].images[0].cam_from_obj)


C2, C4 = turn([0, 0, 1.0], 180), turn([0, 0, 1.0], 90)
FLIP = turn([1.0, 0, 0], 180)
AXIS = {"axis": [0, 0, 1.0], "offset": CENTER.tolist()}


@pytest.mark.parametrize(
    ("discrete", "continuous", "kind", "order"),
    [
        ([C2], [], "finite", 2),
        ([C4], [], "finite", 4),  # a generator only: the group is completed
        ([C4, C4 @ C4, C4 @ C4 @ C4, FLIP], [], "finite", 8),
        ([], [AXIS], "revolution", 1),
        ([C2], [AXIS], "revolution", 1),
        ([FLIP], [AXIS], "revolution", 2),
        ([turn([1.0, 0, 0], 90)], [AXIS], "sphere", 1),
        ([], [AXIS, {"axis": [0, 1.0, 0], "offset": CENTER.tolist()}], "sphere", 1),
    ],
)
def test_every_stated_symmetry_is_no_motion(tmp_path, discrete, continuous, kind, order):
    motions = [about(rotation) for rotation in discrete]
    stated = {
        "symmetries_discrete": [motion.ravel().tolist() for motion in motions],
        "symmetries_continuous": continuous,
    }
    model = bop.read_ground_truth(write_dataset(tmp_path / "set", stated), object_id=1).object
    assert (model.symmetry.kind, len(model.symmetry.rotations)) == (kind, order)
    motions += [about(turn(axis["axis"], angle)) for axis in continuous for angle in (33.0, 180.0)]
    pose = poses.from_rotation_translation(turn([1.0, 2.0, 3.0], 50), [0.1, 0.2, 0.9])
    for motion in motions:
        motion = motion.copy()
        motion[:3, 3] /= 1000
        assert Sym(model)((pose @ motion)[None], pose[None])[0] < 1e-9
    other = pose @ poses.from_rotation_translation(turn([0, 1.0, 0], 40), np.zeros(3))
    assert kind == "sphere" or Sym(model)(other[None], pose[None])[0] > 5e-3


ASIDE = np.array([4.0, 0, 0])


def test_the_centroid_is_moved_to_the_axis_that_is_stated_and_it_is_said(tmp_path):
    aside = {"axis": [0, 0, 2.0], "offset": (CENTER + ASIDE).tolist()}
    truth = bop.read_ground_truth(write_dataset(tmp_path / "set", {"symmetries_continuous": [aside]}), object_id=1)
    np.testing.assert_allclose(1000 * truth.object.centroid, CENTER + ASIDE, atol=1e-6)
    np.testing.assert_allclose(poses.apply(truth.object.inertial_from_obj, truth.object.centroid[None]), 0, atol=1e-12)
    assert any("4 mm" in remark for remark in truth.remarks)


@pytest.mark.parametrize(
    ("stated", "word"),
    [
        ({"symmetries_discrete": [np.diag([1.0, 1.0, -1.0, 1.0]).ravel().tolist()]}, "symmetries_discrete"),
        ({"symmetries_discrete": [[1.0] * 15]}, "symmetries_discrete"),
        ({"symmetries_discrete": [about(turn(x, 77.7)).ravel().tolist() for x in np.eye(3)]}, "no finite group"),
        ({"symmetries_discrete": [about(turn([0, 0, 1.0], 77.7)).ravel().tolist()]}, "no finite group"),
        ({"symmetries_continuous": [{"axis": [0, 0, 0], "offset": [0, 0, 0]}]}, "axis"),
        ({"symmetries_continuous": [{"offset": [0, 0, 0]}]}, "axis"),
        ({"symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 500, 0]}]}, "millimeters"),
        ({"symmetries_discrete": [about(C2, CENTER + 500).ravel().tolist()]}, "millimeters"),
        ({"diameter": 0.13}, "millimeters"),
        ({"diameter": "big"}, "diameter"),
    ],
)
def test_object_models_that_make_no_sense_are_refused(tmp_path, stated, word):
    split = write_dataset(tmp_path / "set", stated)
    with pytest.raises(InputError, match=rf"models_info\.json.*{word}"):
        bop.read_ground_truth(split, object_id=1)


def test_published_rounding_of_symmetries_still_gives_a_group():
    thirds = np.round(turn([0, 0, 1.0], 120), 4)
    assert len(symmetry_group(thirds[None], np.zeros((0, 3)), "here").rotations) == 3


def test_without_a_mesh_the_box_stands_in_and_it_is_said(split):
    exact = bop.read_ground_truth(split, object_id=1).object
    (split.parent / "models" / "obj_000001.ply").unlink()
    truth = bop.read_ground_truth(split, object_id=1)
    np.testing.assert_allclose(truth.object.lam_in_obj, exact.lam_in_obj, atol=1e-9)  # it was a box
    assert truth.object.points is None
    assert any("box" in remark for remark in truth.remarks)


@pytest.mark.parametrize("size", [1e155, 0.06, -3e157, -60.0, "wide"])
def test_a_box_of_no_parts_size_is_refused(split, size):
    (split.parent / "models" / "obj_000001.ply").unlink()
    edit(split.parent / "models" / "models_info.json", lambda d: d["1"].update(size_x=size, size_y=size, size_z=size))
    with pytest.raises(InputError, match=r"models_info\.json"):
        bop.read_ground_truth(split, object_id=1)


def test_another_mesh_and_symmetry_may_be_given(split, tmp_path):
    write_box(tmp_path / "own.ply")
    own = {"mesh": tmp_path / "own.ply", "units": "mm", "symmetry": "none"}
    (split.parent / "models" / "obj_000001.ply").unlink()
    truth = bop.read_ground_truth(split, object_id=1, **own)
    assert truth.object.points is not None
    assert truth.object.symmetry.name == "none"


@pytest.mark.parametrize("detection", [False, True])
def test_targets_choose_the_images(split, tmp_path, detection):
    target = {"scene_id": 1, "im_id": 3} | ({} if detection else {"obj_id": 1, "inst_count": 2})
    (tmp_path / "targets.json").write_text(json.dumps([target]))
    truth = bop.read_ground_truth(split, object_id=1, targets=tmp_path / "targets.json")
    assert [image.id for image in truth.images] == ["000001-000003"]
    (tmp_path / "targets.json").write_text(json.dumps([target | {"im_id": 9}]))
    with pytest.raises(InputError, match=r"targets\.json"):
        bop.read_ground_truth(split, object_id=1, targets=tmp_path / "targets.json")


def test_a_multi_view_list_chooses_one_sensors_views_in_its_order(tmp_path):
    split = write_dataset(tmp_path / "set", scenes=(1, 7), sensor="_cam2")
    views = [
        {"scene_id": 7, "im_id": [["cam1", 3], ["cam2", 4], ["cam2", 3]]},
        {"scene_id": 1, "im_id": [["cam1", 4], ["cam2", 3]]},
    ]
    path = tmp_path / "test_targets_multiview_bop25.json"
    path.write_text(json.dumps(views))
    truth = bop.read_ground_truth(split, object_id=1, sensor="cam2", targets=path)
    assert [image.id for image in truth.images] == ["000007-000004", "000007-000003", "000001-000003"]
    with pytest.raises(InputError, match="--sensor cam1"):
        read_targets(path)
    path.write_text(json.dumps([{"scene_id": 1, "im_id": [4, 3]}]))
    assert list(read_targets(path)) == [(1, 4), (1, 3)]
    for im_id in (None, "x", [["cam2"]], [["cam2", 3, 4]], [None], {}):
        path.write_text(json.dumps([{"scene_id": 1, "im_id": im_id}]))
        with pytest.raises(InputError, match="im_id"):
            read_targets(path, "cam2")


def test_sensors_are_told_apart(tmp_path):
    split = write_dataset(tmp_path / "set", sensor="_cam2")
    with pytest.raises(InputError, match="--sensor cam2"):
        bop.read_ground_truth(split, object_id=1)
    assert len(bop.read_ground_truth(split, object_id=1, sensor="cam2").images) == 2


def test_the_size_comes_from_options_or_cameras_json_where_there_are_no_images(split):
    for path in split.rglob("*.png"):
        path.unlink()
    with pytest.raises(InputError, match="--width and --height"):
        bop.read_ground_truth(split, object_id=1)
    assert bop.read_ground_truth(split, object_id=1, width=720, height=540).images[0].camera.width == 720
    (split.parent / "camera.json").write_text(json.dumps({"width": 1280, "height": 960}))
    assert bop.read_ground_truth(split, object_id=1).images[0].camera.height == 960


def test_missing_visibility_is_asked_for_and_may_be_given(split, tmp_path):
    (split / "000001" / "scene_gt_info.json").unlink()
    with pytest.raises(InputError, match=r"scene_gt_info\.json.*--visibility"):
        bop.read_ground_truth(split, object_id=1)
    full = bop.read_ground_truth(split, object_id=1, visibility="full")
    assert full.images[0].visibility.tolist() == [1, 1]
    assert any("fully visible" in remark for remark in full.remarks) and full.share is None
    (tmp_path / "seen.json").write_text(json.dumps({"000001-000003": [0.5, 0.6], "000001-000004": []}))
    given = bop.read_ground_truth(split, object_id=1, visibility=str(tmp_path / "seen.json"))
    assert given.images[0].visibility.tolist() == [0.5, 0.6]
    (tmp_path / "seen.json").write_text(json.dumps({"000001-000003": [0.5], "000001-000004": []}))
    with pytest.raises(InputError, match=r"seen\.json.*000001-000003"):
        bop.read_ground_truth(split, object_id=1, visibility=str(tmp_path / "seen.json"))


def test_depth_images_go_out_in_one_coding_also_where_the_poses_are_not_public(split, tmp_path):
    (split / "000001" / "scene_gt.json").unlink()
    out = tmp_path / "depth"
    done = CliRunner().invoke(main, ["depth", str(split), "--from", "bop", "-o", str(out)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert sorted(path.name for path in out.iterdir()) == ["000001-000003.png", "000001-000004.png", "camera.json"]
    assert (cv2.imread(str(out / "000001-000003.png"), cv2.IMREAD_UNCHANGED) == 10_000).all()  # 2000 x 0.5 mm
    assert Camera.load(out / "camera.json") == Camera(80, 60, 600.0, 610.0, 39.5, 29.0)


def test_images_of_several_cameras_go_to_a_folder_each(split, tmp_path):
    edit(split / "000001" / "scene_camera.json", lambda d: d["4"].update(cam_K=[500, *K[1:]]))
    counts = write_depth_images(tmp_path / "depth", bop.depth_images(split))
    assert [(folder.name, count) for folder, count in counts.items()] == [("camera-00", 1), ("camera-01", 1)]
    assert (tmp_path / "depth" / "camera-01" / "000001-000004.png").is_file()


@pytest.mark.parametrize(
    ("name", "change", "word"),
    [
        ("scene_gt", lambda d: d["3"][0].pop("cam_R_m2c"), "'3'.*cam_R_m2c"),
        ("scene_gt", lambda d: d["3"][2].update(cam_R_m2c=[2.0] * 9), "'3'.*instance 2.*rotation"),
        ("scene_gt", lambda d: d["3"][2].update(cam_t_m2c=[0, 0]), "'3'.*instance 2.*cam_t_m2c"),
        ("scene_gt", lambda d: d["3"][2].update(cam_t_m2c=[0, 0, float("nan")]), "cam_t_m2c.*finite"),
        ("scene_gt", lambda d: d["3"][2].update(cam_t_m2c=[0, 0, 0.9]), "'3'.*millimeters"),
        ("scene_gt", lambda d: d["3"][2].update(cam_t_m2c=[0, 0, 20.0]), "'3'.*within 3.* mm of the camera"),
        ("scene_gt", lambda d: d["3"][2].update(cam_t_m2c=[0, 0, 9e5]), "'3'.*unit"),
        ("scene_gt", lambda d: d["3"][0].update(obj_id="1"), "'3'.*obj_id"),
        ("scene_gt", lambda d: d.update({"3": {}}), "'3'"),
        ("scene_gt", lambda d: d.update({"three": []}), "image number"),
        ("scene_gt_info", lambda d: d["3"].pop(), "'3'.*3 instances"),
        ("scene_gt_info", lambda d: d["3"][0].update(visib_fract=7), "'3'.*visib_fract"),
        ("scene_gt_info", lambda d: d["3"][0].pop("visib_fract"), "'3'.*visib_fract"),
        ("scene_camera", lambda d: d.pop("3"), "'3'.*missing"),
        ("scene_camera", lambda d: d["3"].update(cam_K=K[:8]), "'3'.*cam_K"),
        ("scene_camera", lambda d: d["3"].update(cam_K=[600, 30, *K[2:]]), "'3'.*skew"),
        ("scene_camera", lambda d: d["3"].update(cam_K=[-600, 0, *K[2:]]), "'3'.*focal"),
        ("scene_camera", lambda d: d["3"].update(cam_K=np.reshape(K, (3, 3)).T.ravel().tolist()), "'3'.*row by row"),
    ],
)
def test_what_is_wrong_in_a_scene_is_named(split, name, change, word):
    edit(split / "000001" / f"{name}.json", change)
    with pytest.raises(InputError, match=rf"{name}\.json.*{word}"):
        bop.read_ground_truth(split, object_id=1)


@pytest.mark.parametrize("scale", [0, -0.1, None])
def test_a_scale_of_depth_that_gives_no_depth_is_refused_before_an_image_is_read(split, scale):
    edit(split / "000001" / "scene_camera.json", lambda d: d["4"].update(depth_scale=scale))
    with pytest.raises(InputError, match=r"scene_camera\.json: image '4'.*depth_scale"):
        list(bop.depth_images(split))


def test_a_scene_that_lacks_what_others_have_is_not_left_out_in_silence(tmp_path):
    split = write_dataset(tmp_path / "set", scenes=(1, 7))
    (split / "000001" / "scene_camera.json").unlink()
    with pytest.raises(InputError, match=r"000001.*scene_camera\.json"):
        list(bop.depth_images(split))


@pytest.mark.parametrize(
    ("source", "options", "word"),
    [
        ("test", {}, "--object-id with one of 1, 2"),
        ("test", {"object_id": 5}, "one of 1, 2"),
        (".", {"object_id": 1}, "splits, such as .*test"),
        ("models", {"object_id": 1}, "scene_gt"),
        ("nowhere", {"object_id": 1}, "nowhere"),
    ],
)
def test_what_is_not_asked_well_is_answered_with_the_choice(split, source, options, word):
    with pytest.raises(InputError, match=word):
        bop.read_ground_truth(split.parent / source, **options)


def predictions_like(truth):
    rng = np.random.default_rng(1)
    images = [
        PredictionImage(image.id, image.cam_from_obj, rng.standard_normal(len(image.visibility)), time)
        for image, time in zip(truth.images, (0.25, None), strict=True)
    ]
    return Predictions(truth.object.name, images)


def test_results_go_out_and_come_back(split, tmp_path):
    sent = predictions_like(bop.read_ground_truth(split, object_id=2))
    bop_results.write_predictions(tmp_path / "results.csv", sent)
    back = bop_results.read_predictions(tmp_path / "results.csv")
    assert back.object_name == "obj_000002"
    assert [(image.id, image.time_s) for image in back.images] == [("000001-000003", 0.25), ("000001-000004", None)]
    for a, b in zip(sent.images, back.images, strict=True):
        np.testing.assert_allclose(b.cam_from_obj, a.cam_from_obj, rtol=1e-15)
        np.testing.assert_array_equal(b.score, a.score)


def test_the_commands_take_a_dataset_to_a_score_and_results_back_to_bop(split, tmp_path):
    def evalkit(*arguments):
        done = CliRunner().invoke(main, [str(a) for a in arguments], catch_exceptions=False)
        assert done.exit_code == 0, done.output
        return done.output

    truth, ours, theirs = (tmp_path / name for name in ("gt.json", "preds.json", "results.csv"))
    assert "2 instances of obj_000001" in evalkit("gt", split, "--from", "bop", "--object-id", 1, "-o", truth)
    bop_results.write_predictions(theirs, predictions_like(read_ground_truth(truth)))
    evalkit("preds", theirs, "--from", "bop", "-o", ours)
    evalkit("preds", ours, "--to", "bop", "-o", tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_text() == theirs.read_text()
    assert average_precision(read_predictions(ours), read_ground_truth(truth), min_visibility=0.1).ap == 1.0
    assert evalkit("preds", theirs, "--from", "bop", "--to", "sileane", "-o", tmp_path / "results")
    assert (tmp_path / "results" / "000001-000003.json").is_file()
