"""Depth images come from shards, files, folders and Siléane's folders; all say meters, names and one camera."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from evalkit.adapters.depth_images import between_clip_planes
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.depth.sources import open_source
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera

CAMERA = Camera(40, 30, 50.0, 51.0, 19.0, 15.5)
CLIP = (0.87599, 1.70602)


def depth_image(seed: int = 0) -> np.ndarray:
    depth = np.random.default_rng(seed).uniform(1.0, 1.6, (CAMERA.height, CAMERA.width)).astype(np.float32)
    depth[:3] = 0.0
    return depth


def write_camera(folder: Path) -> Path:
    path = folder / "camera.json"
    path.write_text(json.dumps(CAMERA.to_json()))
    return path


def write_folder(folder: Path, names: tuple[str, ...] = ("b", "a", "c")) -> Path:
    folder.mkdir(exist_ok=True)
    for seed, name in enumerate(names):
        cv2.imwrite(str(folder / f"{name}.png"), np.round(depth_image(seed) * 1e4).astype(np.uint16))
    return folder


def write_sileane(folder: Path, names: tuple[str, ...] = ("bunny_3_070", "bunny_3_071")) -> Path:
    (folder / "depth").mkdir(parents=True)
    lines = [
        f"width\t{CAMERA.width}", f"height\t{CAMERA.height}", f"fu\t{CAMERA.fx}", f"fv\t{CAMERA.fy}",
        f"cu\t{CAMERA.cx}", f"cv\t{CAMERA.cy}", f"clip_start\t{CLIP[0]}", f"clip_end\t{CLIP[1]}",
        "location\t0\t0\t1.5", "rotation\t0\t1\t0\t0",
    ]  # fmt: skip
    (folder / "camera_params.txt").write_text("\n".join(lines))
    for seed, name in enumerate(names):
        coded = np.round((depth_image(seed) - CLIP[0]) / (CLIP[1] - CLIP[0]) * 65535)
        cv2.imwrite(str(folder / "depth" / f"{name}.PNG"), np.clip(coded, 0, 65535).astype(np.uint16))
    return folder


def test_shards_give_the_depth_and_the_names_of_their_frames(debug_shards: Path) -> None:
    source, dataset = open_source(debug_shards), ShardDataset(debug_shards)
    assert source.camera == dataset.header.camera
    assert len(set(source.names)) == len(dataset)
    for number in (0, len(dataset) - 1):
        np.testing.assert_array_equal(source.read(number), dataset[number].depth)
        reader, row = dataset.locate(number)
        assert source.names[number] == reader.image_id(row)


def test_a_folder_of_images_is_read_in_the_order_of_its_names(tmp_path: Path) -> None:
    source = open_source(write_folder(tmp_path / "images"), write_camera(tmp_path), 1e-4)
    assert source.names == ["a", "b", "c"]
    assert source.camera == CAMERA
    for number, seed in enumerate((1, 0, 2)):
        assert np.abs(source.read(number) - depth_image(seed)).max() <= 0.51e-4


def test_a_sileane_folder_is_read_by_its_own_camera_and_clipping_planes(tmp_path: Path) -> None:
    folder = write_sileane(tmp_path / "bunny")
    for source in (open_source(folder), open_source(folder / "depth")):
        assert source.names == ["bunny_3_070", "bunny_3_071"]  # as the scenes of gt/*.json are named
        assert source.camera == CAMERA
        assert np.abs(source.read(1) - depth_image(1)).max() <= (CLIP[1] - CLIP[0]) / 65535


def test_both_ends_of_sileanes_scale_are_no_return() -> None:
    depth = between_clip_planes(np.array([0, 1, 65534, 65535], np.uint16), 1.0, 2.0)
    assert depth[0] == 0 and depth[3] == 0
    np.testing.assert_allclose(depth[1:3], [1.0, 2.0], atol=2e-5)


def test_a_camera_that_the_user_gives_goes_before_camera_params(tmp_path: Path) -> None:
    folder = write_folder(write_sileane(tmp_path / "bunny"))
    assert open_source(folder, write_camera(tmp_path), 1e-4).names == ["a", "b", "c"]


def test_the_camera_may_be_as_ros_or_bop_write_it(tmp_path: Path) -> None:
    folder, ros, bop = write_folder(tmp_path / "images"), tmp_path / "info.yaml", tmp_path / "bop.json"
    ros.write_text("height: 30\nwidth: 40\ndistortion_model: plumb_bob\nk: [50.0, 0, 19.0, 0, 51.0, 15.5, 0, 0, 1]\n")
    bop.write_text(json.dumps(CAMERA.to_json() | {"depth_scale": 0.1}))
    for path in (ros, bop):
        assert open_source(folder, path, 1e-4).camera == CAMERA
    ros.write_text(ros.read_text().replace("plumb_bob", "equidistant"))
    with pytest.raises(InputError, match=r"info\.yaml.*equidistant"):
        open_source(folder, ros, 1e-4)


def test_few_of_many_images_are_spread_over_the_source(debug_shards: Path) -> None:
    source = open_source(debug_shards)
    assert source.spread(2) == [0, len(source.names) - 1]
    assert source.spread(None) == source.spread(10**6) == list(range(len(source.names)))


def test_what_cannot_be_read_is_refused_in_one_sentence(tmp_path: Path) -> None:
    camera, empty, twins = write_camera(tmp_path), tmp_path / "empty", write_folder(tmp_path / "twins")
    empty.mkdir()
    np.save(twins / "a.npy", depth_image())
    eight_bit, archive = tmp_path / "gray.png", tmp_path / "archive.npy"
    cv2.imwrite(str(eight_bit), np.zeros((30, 40), np.uint8))
    with open(archive, "wb") as file:
        np.savez(file, depth_image())
    flipped = write_sileane(tmp_path / "flipped")
    parameters = (flipped / "camera_params.txt").read_text()
    (flipped / "camera_params.txt").write_text(parameters.replace(f"clip_end\t{CLIP[1]}", "clip_end\t0.1"))
    refusals = [
        (tmp_path / "absent", None, "absent"),
        (tmp_path / "absent.png", camera, "absent.png"),
        (empty, camera, "neither shards nor depth images"),
        (twins, camera, "same name"),
        (write_folder(tmp_path / "plain"), None, "--camera"),
        (eight_bit, camera, "8-bit"),
        (archive, camera, "archive.npy"),
        (flipped, None, "clip_start"),
    ]
    for path, camera_file, says in refusals:
        with pytest.raises(InputError, match=says) as caught:
            open_source(path, camera_file, 1e-4 if camera_file else None).read(0)
        assert "\n" not in str(caught.value)


def write_bop(folder: Path) -> Path:
    """A split of two scenes, whose images have different cameras and scales of depth."""
    for scene in (1, 2):
        here = folder / "test" / f"{scene:06d}"
        (here / "depth").mkdir(parents=True)
        cameras = {}
        for image in (0, 3):
            matrix = [CAMERA.fx + image, 0, CAMERA.cx, 0, CAMERA.fy, CAMERA.cy, 0, 0, 1]
            cameras[str(image)] = {"cam_K": matrix, "depth_scale": 0.1 * scene}
            raw = np.round(depth_image(10 * scene + image) / (1e-4 * scene)).astype(np.uint16)
            cv2.imwrite(str(here / "depth" / f"{image:06d}.png"), raw)
        (here / "scene_camera.json").write_text(json.dumps(cameras))
    targets = [{"scene_id": 2, "im_id": 3, "obj_id": 1, "inst_count": 1}]
    (folder / "test_targets_bop19.json").write_text(json.dumps(targets))
    return folder


def test_a_bop_split_or_scene_is_read_with_each_images_camera_and_scale(tmp_path: Path) -> None:
    dataset = write_bop(tmp_path / "set")
    source = open_source(dataset / "test")
    assert source.names == ["000001-000000", "000001-000003", "000002-000000", "000002-000003"]
    assert [camera.fx for camera in source.cameras] == [CAMERA.fx, CAMERA.fx + 3] * 2
    for number, seed in enumerate((10, 13, 20, 23)):
        np.testing.assert_allclose(source.read(number), depth_image(seed), atol=1.1e-4)
    assert open_source(dataset / "test" / "000002").names == source.names[2:]
    targets = dataset / "test_targets_bop19.json"
    for folder in (dataset, dataset / "test", dataset / "test" / "000002"):
        assert open_source(folder, targets=targets).names == ["000002-000003"]


def test_a_bop_folder_without_cameras_is_refused(tmp_path: Path) -> None:
    scene = write_bop(tmp_path / "set") / "test" / "000001"
    (scene / "scene_camera.json").rename(scene / "scene_gt.json")
    for folder in (scene, scene.parent):
        if folder != scene:
            (folder / "000002" / "scene_camera.json").unlink()
        with pytest.raises(InputError, match=r"without scene_camera\.json"):
            open_source(folder)
    assert len(open_source(scene / "depth", write_camera(tmp_path), 1e-4).names) == 2
    with pytest.raises(InputError, match="--targets"):
        open_source(scene / "depth", write_camera(tmp_path), 1e-4, targets=tmp_path / "targets.json")


def test_a_camera_beside_a_folders_images_is_taken_and_that_is_said(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "images")
    (folder / "camera.json").write_text(json.dumps(CAMERA.to_json() | {"depth_scale": 0.1}))
    source = open_source(folder)
    assert source.camera == CAMERA
    np.testing.assert_allclose(source.read(0), depth_image(1), atol=0.51e-4)
    assert "camera.json" in source.remarks[0]


def test_pictures_and_meshes_beside_depth_images_are_left_out_and_that_is_said(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "frames")
    for name, picture in (("color_a", np.zeros((30, 40, 3), np.uint8)), ("mask_a", np.zeros((30, 40), np.uint8))):
        cv2.imwrite(str(folder / f"{name}.png"), picture)
    cv2.imwrite(str(folder / "color_deep.png"), np.zeros((30, 40, 3), np.uint16))
    (folder / "part.ply").write_text("ply\nformat ascii 1.0\nelement vertex 1\n")
    source = open_source(folder, write_camera(tmp_path), 1e-4)
    assert source.names == ["a", "b", "c"]
    assert [remark for remark in source.remarks if "left out is what holds none" in remark and "3 more" in remark]


def test_pictures_alone_are_refused(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    cv2.imwrite(str(tmp_path / "frames" / "color.png"), np.zeros((30, 40, 3), np.uint8))
    source = open_source(tmp_path / "frames", write_camera(tmp_path), 1e-4)
    with pytest.raises(InputError, match=r"color\.png"):
        source.read(0)


def test_what_is_hidden_or_not_called_depth_beside_what_is_is_left_out(tmp_path: Path) -> None:
    depth = np.full((CAMERA.height, CAMERA.width), 700, np.uint16)
    for name in ("a_depth.png", "a_ir.png"):
        cv2.imwrite(str(tmp_path / name), depth)
    (tmp_path / "._a_depth.png").write_bytes(b"macOS")
    source = open_source(tmp_path, write_camera(tmp_path), 0.001)
    assert source.names == ["a_depth"] and "left out" in source.remarks[0] and "a_ir.png" in source.remarks[0]


def test_a_folder_of_what_is_not_read_says_what_to_give(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "a.raw").write_bytes(bytes(64))
    with pytest.raises(InputError, match="raw bytes say neither size nor type"):
        open_source(tmp_path / "frames", write_camera(tmp_path), 0.001)
    (tmp_path / "frames" / "depth").mkdir()
    with pytest.raises(InputError, match=r"give the folder in it, .*depth"):
        open_source(tmp_path / "frames", write_camera(tmp_path), 0.001)
