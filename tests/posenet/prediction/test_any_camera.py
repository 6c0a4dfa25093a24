"""Any camera, any resolution, any distance: the right answer, or one sentence that says what to mend."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from evalkit.datasets.scene import View
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.depth.clean import clean_depth
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from posenet.config import preset, with_options
from posenet.network.depth_input import pad_to_multiple
from posenet.network.pose_network import PoseNetwork
from posenet.prediction.any_camera import check_distance, trained_grid
from posenet.prediction.predictor import Predictor

TRAINED = Camera(160, 120, 144.0, 140.0, 79.5, 59.5)
DEPTHS = (0.3, 0.6)


@pytest.fixture(scope="module")
def view(debug_shards: Path) -> View:
    return ShardDataset(debug_shards)[0]


@pytest.fixture(scope="module")
def predictor(run_folder: Path) -> Predictor:
    return Predictor.load(run_folder, "cpu")


@pytest.fixture(scope="module", params=["relative", "absolute"])
def network(request: pytest.FixtureRequest, debug_shards: Path) -> PoseNetwork:
    config = with_options(preset("debug"), "network", depth=request.param)
    return PoseNetwork(config, ShardDataset(debug_shards).header.object, DEPTHS, TRAINED)


def flat(camera: Camera, depth: float) -> np.ndarray:
    return np.full((camera.height, camera.width), depth, np.float32)


@pytest.mark.parametrize(("wider", "higher"), [(2.0, 2.0), (0.5, 0.5), (2.0, 3.0), (1.0, 1.5), (24.0, 18.0)])
def test_an_image_is_brought_to_the_trained_focal_length_along_each_axis(
    network: PoseNetwork, wider: float, higher: float
) -> None:
    camera = TRAINED.resized(round(160 * wider), round(120 * higher))
    grid = trained_grid(flat(camera, 0.45), camera, network)
    assert (grid.width, grid.height) == (160, 120)
    assert (grid.fx, grid.fy) == pytest.approx((TRAINED.fx, TRAINED.fy))


def test_a_farther_scene_is_enlarged_until_its_objects_have_their_trained_size(network: PoseNetwork) -> None:
    for distance in (0.05, 0.2, 0.9, 1.3, 3.0):
        grid = trained_grid(flat(TRAINED, distance), TRAINED, network)
        assert grid.fy / grid.fx == pytest.approx(TRAINED.fy / TRAINED.fx, rel=0.02)
        if network.config.network.depth == "relative":
            known = [TRAINED.fx / depth for depth in DEPTHS]
            assert known[1] * 0.9 < grid.fx / distance < known[0] * 1.1
        else:
            assert grid == TRAINED  # bins of absolute depth know their own distances only


def test_a_camera_that_would_need_a_gigantic_image_is_refused(network: PoseNetwork) -> None:
    camera = Camera(4000, 3000, 20.0, 20.0, 2000.0, 1500.0)
    with pytest.raises(InputError, match="focal length of 20"):
        trained_grid(flat(camera, 0.45), camera, network)


@pytest.mark.parametrize("unit", [1e-3, 0.01, 0.1, 10.0, 100.0, 1000.0])
def test_a_wrong_unit_is_refused(network: PoseNetwork, unit: float) -> None:
    with pytest.raises(InputError, match=r"image 'x'.*--depth-unit|lie outside"):
        check_distance(flat(TRAINED, 0.45 * unit), TRAINED, network, "image 'x'")


def test_bins_of_absolute_depth_refuse_what_they_cannot_reach(debug_shards: Path) -> None:
    config = with_options(preset("debug"), "network", depth="absolute")
    network = PoseNetwork(config, ShardDataset(debug_shards).header.object, DEPTHS, TRAINED)
    with pytest.raises(InputError, match=r"lie outside those that the model was trained for"):
        check_distance(flat(TRAINED, 1.2), TRAINED, network, "the depth image")
    check_distance(flat(TRAINED, 0.5), TRAINED, network, "the depth image")


def test_nan_infinity_and_negative_depths_are_no_return() -> None:
    camera = Camera(5, 1, 10.0, 10.0, 2.0, 0.0)
    depth = np.array([[np.nan, np.inf, -np.inf, -1.0, 0.5]])
    assert clean_depth(depth, camera, "x").tolist() == [[0, 0, 0, 0, 0.5]]
    with pytest.raises(InputError, match="5 x 1"):
        clean_depth(depth.T, camera, "x")
    with pytest.raises(InputError, match="type"):
        clean_depth(depth.astype(complex), camera, "x")


@pytest.mark.parametrize("size", [(1, 1), (7, 9), (8, 8), (120, 157)])
def test_padding_reaches_the_next_multiple_and_leaves_the_image_alone(size: tuple[int, int]) -> None:
    images = torch.rand(2, *size)
    padded = pad_to_multiple(images, 8)
    assert padded.shape[-1] % 8 == padded.shape[-2] % 8 == 0
    assert padded.shape[-1] - size[1] < 8 and padded.shape[-2] - size[0] < 8
    torch.testing.assert_close(padded[:, : size[0], : size[1]], images)
    assert padded.sum() == pytest.approx(float(images.sum()), rel=1e-5)


@pytest.mark.parametrize(("wider", "higher"), [(3, 3), (5, 3), (23, 23)])
def test_the_same_view_in_other_pixels_gives_the_same_poses(
    predictor: Predictor, view: View, wider: int, higher: int
) -> None:
    """Every pixel repeated, up to a 4K image: resampling takes exactly the original ones back."""
    camera = view.camera.resized(wider * view.camera.width, higher * view.camera.height)
    depth = cv2.resize(view.depth, None, fx=wider, fy=higher, interpolation=cv2.INTER_NEAREST)
    small, large = predictor.predict(view.depth, view.camera), predictor.predict(depth, camera)
    np.testing.assert_allclose(large.cam_from_obj, small.cam_from_obj, atol=1e-4)
    np.testing.assert_allclose(large.score, small.score, atol=1e-3)
    np.testing.assert_allclose(large.boxes, small.boxes * np.tile([wider, higher], 2), atol=0.1 * wider)


@pytest.mark.parametrize(("width", "height"), [(157, 113), (61, 119), (40, 40)])
def test_a_cropped_image_of_any_size_gives_boxes_inside_it(
    predictor: Predictor, view: View, width: int, height: int
) -> None:
    camera = Camera(width, height, view.camera.fx, view.camera.fy, view.camera.cx, view.camera.cy)
    found = predictor.predict(view.depth[:height, :width], camera)
    assert (found.boxes >= 0).all() and (found.boxes <= [width, height] * 2).all()
    assert np.isfinite(found.cam_from_obj).all()


@pytest.mark.parametrize("size", [(1, 1), (3, 200)])
def test_an_image_too_small_to_hold_the_object_is_refused_or_empty(predictor: Predictor, size: tuple[int, int]) -> None:
    camera = Camera(size[1], size[0], 144.0, 144.0, 0.0, 0.0)
    assert len(predictor.predict(np.zeros(size), camera).score) == 0
    if size == (1, 1):
        with pytest.raises(InputError, match="pixels across in 1 x 1"):
            predictor.predict(np.full(size, 0.4), camera)


def test_images_of_one_batch_may_lie_at_different_distances(predictor: Predictor, view: View) -> None:
    far = np.where(view.depth > 0, view.depth + 1.0, 0.0)
    together = predictor.predict_batch([view.depth, far, np.zeros_like(far)], view.camera)
    assert len(together[0].score) > 0 and len(together[2].score) == 0
    alone = predictor.predict(view.depth, view.camera)
    np.testing.assert_allclose(together[0].cam_from_obj, alone.cam_from_obj, atol=1e-4)
    centers = predictor.model.centers(together[1].cam_from_obj)
    assert (centers[:, 2] > 0.8).all()


def test_messages_of_a_batch_name_the_image(predictor: Predictor, view: View) -> None:
    with pytest.raises(InputError, match="image 'second'"):
        predictor.predict_batch([view.depth, view.depth * 1000], view.camera, ["first", "second"])
