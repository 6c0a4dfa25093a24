"""Images of any resolution train at the scale at which the network knows objects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from posenet.config import preset
from posenet.figures.looked_at import look_at
from posenet.models.model_file import load_model
from posenet.network.depth_input import resample
from posenet.prediction.any_camera import trained_grid
from posenet.prediction.predictor import Predictor
from posenet.training.dataset import Frames
from posenet.training.fit_options import FitOptions
from posenet.training.train import fit
from posenet.training.working_scale import TOLERATED, choose_scale

DIAMETER, WANTED = 0.1, 67.0


def camera_that_shows(pixels: float, width: int, height: int) -> Camera:
    """A camera in which the object, a meter away, is so many pixels across."""
    focal = pixels / DIAMETER
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


@pytest.mark.parametrize(
    ("pixels", "width", "height"),
    [(67, 320, 240), (60, 1920, 1200), (134, 640, 480), (400, 1920, 1200), (20, 640, 480)],
)
def test_objects_are_never_larger_than_the_network_likes_and_images_never_enlarged(
    pixels: float, width: int, height: int
) -> None:
    camera = camera_that_shows(pixels, width, height)
    scale = choose_scale(camera, DIAMETER, 1.0, WANTED)
    working = scale.camera(camera)
    size = working.fx * DIAMETER
    assert scale.factor <= 1.0 and size <= TOLERATED * WANTED * 1.01
    if pixels > TOLERATED * WANTED:
        assert size == pytest.approx(WANTED, rel=0.07)
    else:
        assert working == camera


def test_twice_the_pixels_train_as_the_half_of_them_would() -> None:
    fine, coarse = camera_that_shows(134, 640, 480), camera_that_shows(67, 320, 240)
    working = choose_scale(fine, DIAMETER, 1.0, WANTED).camera(fine)
    assert (working.width, working.height, working.fx) == (coarse.width, coarse.height, pytest.approx(coarse.fx))


def test_an_object_of_less_than_six_pixels_is_refused_in_one_sentence() -> None:
    with pytest.raises(InputError, match=r"1920 x 1200 are too coarse: .* 5 pixels across"):
        choose_scale(camera_that_shows(5, 1920, 1200), DIAMETER, 1.0, WANTED)
    with pytest.raises(InputError, match=r"--scale 0.05: .* larger scale"):
        choose_scale(camera_that_shows(67, 320, 240), DIAMETER, 1.0, WANTED, asked=0.05)


def test_a_scale_that_was_asked_for_is_taken_and_said() -> None:
    scale = choose_scale(camera_that_shows(67, 320, 240), DIAMETER, 1.0, WANTED, asked=0.5)
    assert scale.factor == 0.5 and "--scale" in scale.reason
    assert choose_scale(camera_that_shows(400, 1920, 1200), DIAMETER, 1.0, wanted=0.0).factor == 1.0


@pytest.mark.parametrize("size", [(80, 60), (79, 60), (53, 41), (160, 120), (111, 97)])
def test_a_sampled_pixel_lies_on_the_ray_that_its_camera_says(size: tuple[int, int]) -> None:
    """A tilted plane, sampled, is the same plane seen by the sampled camera: exactly at half the size, else within
    half a pixel and without bias."""
    camera = Camera(160, 120, 150.0, 140.0, 75.0, 62.0)
    across = torch.arange(160.0).expand(120, 160)
    down = torch.arange(120.0)[:, None].expand(120, 160)
    grid = camera.sampled(*size)
    for rays, focal, center, grid_focal, grid_center, along in (
        (across, camera.fx, camera.cx, grid.fx, grid.cx, torch.arange(float(size[0]))),
        (down, camera.fy, camera.cy, grid.fy, grid.cy, torch.arange(float(size[1]))[:, None]),
    ):
        told = (resample(rays + 1, grid) - 1 - center) / focal
        off = (told - (along - grid_center) / grid_focal) * focal
        assert abs(float(off.mean())) < 1e-4
        assert float(off.abs().max()) < (1e-4 if size in ((80, 60), (160, 120)) else 0.51)


def test_frames_at_half_scale_keep_poses_holes_and_what_the_boxes_hold(debug_shards: Path) -> None:
    frames = Frames(debug_shards)
    half = frames.on_grid_of(frames.camera.sampled(80, 60))
    numbers = np.arange(4)
    whole, small = frames.batch(numbers), half.batch(numbers)
    assert small.depth.shape == (4, 60, 80) and frames.batch(numbers).depth.shape == (4, 120, 160)
    for image, fine, boxes, fine_boxes in zip(small.depth, whole.depth, small.boxes, whole.boxes, strict=True):
        assert torch.isin(image, fine).all()
        torch.testing.assert_close(boxes, fine_boxes / 2)
    for poses, fine_poses in zip(small.poses, whole.poses, strict=True):
        torch.testing.assert_close(poses, fine_poses)
    torch.testing.assert_close(small.intrinsics[:, :2], whole.intrinsics[:, :2] / 2)


def test_a_model_carries_its_scale_to_prediction_and_to_figures(debug_shards: Path, tmp_path: Path) -> None:
    options = FitOptions(
        [debug_shards], tmp_path / "run", preset("debug"), epochs=2, device="cpu", scale=0.5, validate=False
    )
    fit(options)
    network = load_model(tmp_path / "run").network
    view = Frames(debug_shards).dataset[0]
    assert network.camera == view.camera.sampled(80, 60)
    assert trained_grid(view.depth, view.camera, network) == network.camera
    seen = look_at(network, view)
    assert seen.view.camera == network.camera
    coarse = Predictor(network).predict(seen.view.depth, network.camera)
    fine = Predictor(network).predict(view.depth, view.camera)
    np.testing.assert_allclose(fine.boxes, coarse.boxes * 2, atol=1e-3)
    np.testing.assert_allclose(fine.cam_from_obj, coarse.cam_from_obj, atol=1e-6)
