"""Only the area of interest is looked at, and what stands around the bin moves nothing."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from evalkit.datasets.scene import View
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from posenet.network.depth_input import scene_depth
from posenet.prediction.area_of_interest import AreaOfInterest, cut_out, parse_rectangle, read_mask
from posenet.prediction.predictor import Predictor

CAMERA = Camera(80, 60, 100.0, 100.0, 39.5, 29.5)


@pytest.fixture(scope="module")
def view(debug_shards: Path) -> View:
    return ShardDataset(debug_shards)[0]


def test_a_rectangle_is_half_open_and_ends_with_the_image() -> None:
    assert parse_rectangle("10,20,12,23", CAMERA).sum() == 6
    assert parse_rectangle("-5,-5,999,999", CAMERA).all()


@pytest.mark.parametrize("words", ["", "1,2,3", "a,b,c,d", "10,10,10,20", "30,0,20,10", "80,0,90,10", "1.5,0,9,9"])
def test_a_rectangle_that_holds_nothing_is_refused_in_one_sentence(words: str) -> None:
    with pytest.raises(InputError, match="--roi") as caught:
        parse_rectangle(words, CAMERA)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_a_mask_is_true_where_it_is_not_black(tmp_path: Path, channels: int) -> None:
    image = np.zeros((60, 80, channels), np.uint8)
    image[10:20, 30:50, 0] = 200
    if channels == 4:
        image[..., 3] = 255  # opaque black is black
    cv2.imwrite(str(tmp_path / "mask.png"), image)
    mask = read_mask(tmp_path / "mask.png", CAMERA)
    assert mask.sum() == 200 and mask[10:20, 30:50].all()


def test_masks_that_fit_nothing_are_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "small.png"), np.full((30, 40), 255, np.uint8))
    cv2.imwrite(str(tmp_path / "black.png"), np.zeros((60, 80), np.uint8))
    cv2.imwrite(str(tmp_path / "left.png"), np.repeat([[255] * 40 + [0] * 40], 60, 0).astype(np.uint8))
    (tmp_path / "text.png").write_text("no picture")
    for name, says in (("small", "40 x 30"), ("black", "black"), ("text", "not a readable"), ("none", "no such")):
        with pytest.raises(InputError, match=says):
            read_mask(tmp_path / f"{name}.png", CAMERA)
    with pytest.raises(InputError, match="nothing is left"):
        AreaOfInterest(tmp_path / "left.png", "50,0,80,60").mask(CAMERA)
    assert AreaOfInterest(tmp_path / "left.png", "30,0,80,60").mask(CAMERA).sum() == 600  # type: ignore[union-attr]


def test_a_point_of_the_cropped_image_lies_where_it_lay() -> None:
    depth = np.full((60, 80), 0.5, np.float32)
    mask = np.zeros((60, 80), bool)
    mask[20:40, 30:70] = True
    mask[20, 30] = False
    (image,), camera, (x0, y0) = cut_out([depth], CAMERA, mask)
    assert image.shape == (20, 40) and (x0, y0) == (30, 20)
    assert image[0, 0] == 0 and (image > 0).sum() == 799
    np.testing.assert_allclose(camera.unproject([5, 7], 0.5), CAMERA.unproject([35, 27], 0.5))


def test_what_lies_outside_the_mask_changes_nothing_and_boxes_count_from_the_whole_image(
    run_folder: Path, view: View
) -> None:
    predictor = Predictor.load(run_folder, "cpu")
    mask = np.zeros_like(view.depth, bool)
    mask[20:110, 30:150] = True
    clutter = np.where(mask, view.depth, np.float32(9.0))
    found, same = (predictor.predict(depth, view.camera, mask) for depth in (view.depth, clutter))
    assert len(found.score) > 0
    np.testing.assert_array_equal(found.cam_from_obj, same.cam_from_obj)
    middle = found.boxes.reshape(-1, 2, 2).mean(1)
    projected = view.camera.project(predictor.model.centers(found.cam_from_obj))
    assert np.median(np.abs(projected - middle)) < 12
    assert (found.boxes[:, :2] >= [30, 20]).all() and (found.boxes[:, 2:] <= [150, 110]).all()


@pytest.mark.parametrize("background", [1.3, 3.0, 0.05])
def test_a_background_beyond_the_objects_distances_does_not_shift_the_scenes_depth(background: float) -> None:
    generator = torch.Generator().manual_seed(0)
    objects = 0.4 + 0.1 * torch.rand(1, 120, 160, generator=generator)
    scene = objects.clone()
    scene[:, :, :110] = background  # two thirds of the image
    alone = objects.clone()
    alone[:, :, :110] = 0.0
    of = [float(scene_depth(depth, (0.35, 0.6), 0.1)) for depth in (scene, alone)]
    assert of[0] == of[1] == pytest.approx(0.45, abs=0.01)


def test_a_scene_far_from_the_trained_distances_has_its_own_depth() -> None:
    assert float(scene_depth(torch.full((1, 40, 40), 2.0), (0.35, 0.6), 0.1)) == 2.0
    assert float(scene_depth(torch.zeros(1, 40, 40), (0.35, 0.6), 0.1)) == 1.0


def test_the_command_takes_an_area_and_refuses_one_that_fits_no_image(
    run_folder: Path, view: View, tmp_path: Path, run_command: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    np.save(tmp_path / "depth.npy", view.depth)
    (tmp_path / "camera.json").write_text(json.dumps(view.camera.to_json()))
    cv2.imwrite(str(tmp_path / "mask.png"), np.full((10, 10), 255, np.uint8))
    words = ("posenet", "predict", run_folder, tmp_path / "depth.npy", "--camera", tmp_path / "camera.json")
    done = run_command(*words, "--roi", "20,20,140,110", "-o", tmp_path / "preds.json")
    assert done.returncode == 0, done.stderr
    done = run_command(*words, "--mask", tmp_path / "mask.png", "-o", tmp_path / "none.json")
    assert done.returncode == 2 and "10 x 10" in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "none.json").exists()
