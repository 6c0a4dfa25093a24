"""`simgen export`: what goes out comes back through evalkit's own readers, and interrupted exports are gone on with."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from evalkit import InputError, PredictionImage, Predictions, average_precision
from evalkit.adapters.bop import dataset as bop
from evalkit.adapters.bop import results as bop_results
from evalkit.adapters.bop.export import write_scene
from evalkit.adapters.sileane import dataset as sileane
from evalkit.adapters.sileane.export import write_view
from evalkit.datasets.ground_truth import read_ground_truth
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.datasets.visibility_share import with_share
from evalkit.geometry import poses
from simgen.exports import foreign_formats as export
from simgen.exports.foreign_formats import export_bop, export_sileane, open_whole


def ignore(frames):
    pass


@pytest.fixture(scope="module")
def dataset(debug_shards):
    return open_whole(debug_shards)


@pytest.fixture(scope="module")
def bop_set(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("bop") / "set"
    export_bop(dataset, out, "test", ignore)
    return out


@pytest.fixture(scope="module")
def sileane_set(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("sileane") / "bunny"
    export_sileane(dataset, out, ignore)
    return out


@pytest.fixture
def truth(debug_shards):
    return read_ground_truth(debug_shards)


def bop_name(image_id):
    scene, view = image_id.split("-")
    return f"{int(scene):06d}-{int(view):06d}"


def assert_same_truth(back, truth, name=str):
    images = {image.id: image for image in back.images}
    assert list(images) == [name(image.id) for image in truth.images]
    for image in truth.images:
        found = images[name(image.id)]
        assert found.camera == image.camera
        np.testing.assert_allclose(found.cam_from_obj, image.cam_from_obj, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.visibility, image.visibility, rtol=0, atol=1e-7)
    assert back.share == truth.share


def assert_same_depth(images, dataset):
    images = list(images)
    assert len(images) == len(dataset)
    for image, view in zip(images, dataset, strict=True):
        assert image.camera == view.camera
        np.testing.assert_allclose(image.read(), view.depth_raw * view.depth_unit, rtol=0, atol=1e-9)


def test_bop_keeps_poses_cameras_visibility_and_every_step_of_depth(bop_set, dataset, truth):
    assert_same_truth(bop.read_ground_truth(bop_set / "test", mesh_frame=True), truth, bop_name)
    assert_same_depth(bop.depth_images(bop_set / "test"), dataset)


def test_sileane_keeps_poses_cameras_visibility_and_every_step_of_depth(sileane_set, dataset, truth):
    assert_same_truth(sileane.read_ground_truth(sileane_set), with_share(truth, "returned"))
    assert_same_depth(sileane.depth_images(sileane_set), dataset)


def test_both_keep_the_mesh_to_its_last_digit(bop_set, sileane_set, truth):
    for model in (bop.read_ground_truth(bop_set / "test", mesh_frame=True).object, sileane.read_object(sileane_set)):
        np.testing.assert_allclose(model.vertices, truth.object.vertices, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(model.faces, truth.object.faces)


def test_bops_masks_say_what_its_numbers_say(bop_set, dataset):
    for view in dataset:
        folder = bop_set / "test" / f"{view.scene_index:06d}"
        infos = json.loads((folder / "scene_gt_info.json").read_text())[str(view.view_index)]
        for row, info in enumerate(infos):
            name = f"{view.view_index:06d}_{row:06d}.png"
            whole, seen = (cv2.imread(str(folder / kind / name), -1) == 255 for kind in ("mask", "mask_visib"))
            assert not (seen & ~whole).any()
            assert seen.sum() == info["px_count_visib"] == view.instances.pixels_geometric[row]
            assert (whole & (view.depth_raw > 0)).sum() == info["px_count_valid"]
            assert max(info["px_count_visib"], info["px_count_valid"]) <= info["px_count_all"]
            assert info["visib_fract"] == pytest.approx(info["px_count_visib"] / max(info["px_count_all"], 1), abs=1e-6)
            if not seen.any():
                assert info["bbox_obj"] == info["bbox_visib"] == [-1, -1, -1, -1]
                continue
            assert info["bbox_visib"] == box_of(seen)
            if whole.sum() == info["px_count_all"]:  # nothing of it lies beyond the frame
                assert info["bbox_obj"] == box_of(whole)


def box_of(mask):
    """x, y, width, height as bop_toolkit's calc_2d_bbox has them: a single pixel has a box of no size."""
    v, u = np.nonzero(mask)
    return [u.min(), v.min(), u.max() - u.min(), v.max() - v.min()]


def test_bops_model_has_its_origin_at_the_center_of_its_box(bop_set, truth):
    info = json.loads((bop_set / "models_eval" / "models_info.json").read_text())["1"]
    for axis in "xyz":
        assert info[f"min_{axis}"] == pytest.approx(-info[f"size_{axis}"] / 2, abs=1e-9)
    np.testing.assert_allclose(np.array(info["origin_in_mesh"]) / 1000, truth.object.box_center, atol=1e-12)
    moved = bop.read_ground_truth(bop_set / "test")
    for image, known in zip(moved.images, truth.images, strict=True):  # each vertex is where it was
        np.testing.assert_allclose(
            poses.apply(image.cam_from_obj, moved.object.vertices),
            poses.apply(known.cam_from_obj, truth.object.vertices),
            atol=1e-9,
        )


def test_results_in_bops_format_go_there_and_come_back_in_the_meshs_own_frame(bop_set, truth, tmp_path):
    info = bop_set / "models" / "models_info.json"
    images = [PredictionImage(bop_name(i.id), i.cam_from_obj, i.visibility) for i in truth.images]
    found = Predictions(truth.object.reference, images)
    bop_results.write_predictions(tmp_path / "results.csv", found, object_id=1, models_info=info)
    in_bop, in_mesh = bop.read_ground_truth(bop_set / "test"), bop.read_ground_truth(bop_set / "test", mesh_frame=True)
    as_it_is = bop_results.read_predictions(tmp_path / "results.csv")
    back = bop_results.read_predictions(tmp_path / "results.csv", models_info=info)
    for predictions, same, other in ((as_it_is, in_bop, None), (back, in_mesh, in_bop), (found, in_mesh, in_bop)):
        assert average_precision(predictions, same, "mssd", threshold=1e-6).ap == 1.0
        if other is not None:
            with pytest.raises(InputError, match=r"--mesh-frame.*--models-info"):
                average_precision(predictions, other, "mssd")
    remark = bop_results.write_predictions(tmp_path / "mesh.csv", found, object_id=1)
    assert "--models-info" in remark
    with pytest.raises(InputError, match="origin_in_mesh"):
        bop_results.read_predictions(tmp_path / "results.csv", models_info=bop_set / "camera.json")


def test_bops_lists_of_targets_name_every_image_and_which_belong_together(bop_set, truth):
    numbers = [tuple(map(int, image.id.split("-"))) for image in truth.images]
    detection = json.loads((bop_set / "test_targets_bop24.json").read_text())
    assert [(row["scene_id"], row["im_id"]) for row in detection] == numbers
    views = json.loads((bop_set / "test_targets_multiview_bop25.json").read_text())
    assert [(row["scene_id"], view) for row in views for view in row["im_id"]] == numbers
    assert len(views) == len({scene for scene, _ in numbers})
    for name in ("bop24", "multiview_bop25"):
        chosen = bop.read_ground_truth(bop_set / "test", targets=bop_set / f"test_targets_{name}.json")
        assert len(chosen.images) == len(truth.images)


def test_what_the_sensor_lost_is_visible_to_bop_and_hidden_to_sileane(dataset, tmp_path):
    view = replace(dataset[0], depth_raw=np.zeros_like(dataset[0].depth_raw))
    lost = np.zeros(len(view.instances))
    view = replace(view, instances=replace(view.instances, visibility_returned=lost.astype(np.float32)))
    parts = [view.instance_id == i + 1 for i in view.instances.instance]
    write_scene(tmp_path / "000000", [view], lambda _: parts, np.zeros(3))
    infos = json.loads((tmp_path / "000000" / "scene_gt_info.json").read_text())["0"]
    assert [info["px_count_visib"] for info in infos] == view.instances.pixels_geometric.tolist()
    assert [info["visib_fract"] for info in infos] == view.instances.visibility_geometric.tolist()
    assert {info["px_count_valid"] for info in infos} == {0}
    for name in ("depth", "segmentation", "gt"):
        (tmp_path / name).mkdir()
    write_view(tmp_path, view, np.eye(4))
    rows = json.loads((tmp_path / "gt" / f"{view.image_id}.json").read_text())
    assert {row["occlusion_rate"] for row in rows} == {1.0}


def test_bops_targets_count_the_instances_that_are_a_tenth_visible(bop_set, truth):
    targets = json.loads((bop_set / "test_targets_bop19.json").read_text())
    expected = [(image.id, int((image.visibility >= 0.1).sum())) for image in truth.images]
    found = [(f"{row['scene_id']:06d}-{row['im_id']:03d}", row["inst_count"]) for row in targets]
    assert found == [(name, count) for name, count in expected if count]


def test_sileanes_segmentation_holds_the_ids_that_its_labels_name(sileane_set, dataset):
    view = dataset[0]
    ids = cv2.imread(str(sileane_set / "segmentation" / f"{view.image_id}.PNG"), cv2.IMREAD_UNCHANGED)
    rows = json.loads((sileane_set / "gt" / f"{view.image_id}.json").read_text())
    counts = [int(((ids == row["segmentation_id"]) & (view.depth_raw > 0)).sum()) for row in rows]
    assert counts == view.instances.pixels_returned.tolist()


@pytest.mark.parametrize(
    ("kind", "write"), [("bop", lambda *a: export_bop(*a[:2], "test", a[2])), ("sileane", export_sileane)]
)
def test_an_interrupted_export_leaves_nothing_at_its_place_and_is_gone_on_with(kind, write, dataset, tmp_path, request):
    whole, out, done = request.getfixturevalue(f"{kind}_set"), tmp_path / "out", []

    def stop_at_the_fifth(frames):
        done.append(frames)
        if len(done) == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write(dataset, out, stop_at_the_fifth)
    assert not out.exists()
    kept = {path: path.stat().st_mtime_ns for path in out.with_name("out.part").rglob("*.png") if "/." not in str(path)}
    write(dataset, out, ignore)
    assert not out.with_name("out.part").exists()
    for path, time in kept.items():  # scenes and images that were complete are not written again
        assert (out / path.relative_to(out.with_name("out.part"))).stat().st_mtime_ns == time
    files = sorted(path.relative_to(whole) for path in whole.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(out) for path in out.rglob("*") if path.is_file())
    assert all((whole / name).read_bytes() == (out / name).read_bytes() for name in files)


def test_what_is_left_of_another_dataset_is_not_gone_on_with(dataset, tmp_path):
    part = tmp_path / "out.part"
    part.mkdir()
    (part / "mine.txt").write_text("precious")
    with pytest.raises(InputError, match=r"out\.part: holds something else"):
        export_sileane(dataset, tmp_path / "out", ignore)
    assert (part / "mine.txt").read_text() == "precious"


def test_a_camera_that_stood_still_keeps_its_world(dataset, tmp_path, monkeypatch):
    pose = dataset[1].cam_from_world
    monkeypatch.setattr(export.sileane_export, "shared_view", lambda cam_from_world: pose)
    export_sileane(dataset, tmp_path / "out", ignore)
    _, cam_from_world = sileane.read_camera_params(tmp_path / "out" / "camera_params.txt")
    np.testing.assert_allclose(cam_from_world, pose, atol=1e-12)
    back = sileane.read_ground_truth(tmp_path / "out")
    np.testing.assert_allclose(back.images[1].cam_from_obj, dataset[1].instances.cam_from_obj, atol=1e-9)


def test_the_command_refuses_in_one_sentence(debug_shards, run_command, tmp_path):
    full, damaged = tmp_path / "full", tmp_path / "damaged"
    full.mkdir()
    (full / "file").write_text("precious")
    shutil.copytree(debug_shards, damaged)
    shard = next(damaged.glob("*.h5"))
    content = bytearray(shard.read_bytes())
    content[len(content) // 2] ^= 1
    shard.write_bytes(content)
    for source, out, words in (
        (debug_shards, full, "is not empty"),
        (debug_shards, full / "file" / "below", "not a folder"),
        (damaged, tmp_path / "out", shard.name),
        (tmp_path / "nowhere", tmp_path / "out", "no such folder"),
    ):
        done = run_command("simgen", "export", "bop", source, out)
        assert done.returncode == 2
        assert words in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1
    assert (full / "file").read_text() == "precious"
    assert not (tmp_path / "out").exists()


def test_the_command_says_what_it_wrote(debug_shards, run_command, tmp_path):
    done = run_command("simgen", "export", "bop", debug_shards, tmp_path / "out", "--split", "train_pbr")
    assert done.returncode == 0, done.stderr
    assert "6 images of 2 scenes of bunny" in done.stdout
    assert (tmp_path / "out" / "train_pbr" / "000001" / "scene_gt.json").is_file()
    assert len(ShardDataset(debug_shards)) == 6
