"""What other depth cameras might have measured: within its bounds, of every kind, and cheap."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
import torch

from posenet.augmentation import depth_errors
from posenet.augmentation.depth_errors import Degradation, degrade, generator_of
from posenet.config import preset
from posenet.training.batches import Batches, degradation_of
from posenet.training.dataset import Frames
from posenet.training.rank import ALONE

DIAMETER, FOCAL = 0.1, 150.0


@pytest.fixture(autouse=True)
def _every_image(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if "clean" not in request.node.name:
        monkeypatch.setattr(depth_errors, "CLEAN", 0.0)


def table(height: int = 96, width: int = 128) -> np.ndarray:
    return (np.full((height, width), 0.6) + 0.0005 * np.arange(height)[:, None]).astype(np.float32)


def step_across(height: int = 96, width: int = 128) -> np.ndarray:
    depth = np.full((height, width), 0.6, np.float32)
    depth[:, width // 2 :] = 0.5
    return depth


def degraded(depth: np.ndarray, noise: float, holes: float, seed: int = 0) -> np.ndarray:
    return degrade(depth, Degradation(noise, holes), DIAMETER, FOCAL, generator_of(seed, 0, 0))


def test_a_seed_a_step_and_an_image_give_one_degradation_and_others_another() -> None:
    keys = ((0, 0, 0), (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
    images = [degrade(table(), Degradation(0.02, 0.05), DIAMETER, FOCAL, generator_of(*key)) for key in keys]
    assert np.array_equal(images[0], images[1])
    assert all(not np.array_equal(images[0], other) for other in images[2:])


def test_without_bounds_images_stay_as_they_are() -> None:
    assert np.array_equal(degraded(step_across(), 0.0, 0.0), step_across())


def test_a_share_of_the_images_stays_clean() -> None:
    same = [np.array_equal(degraded(step_across(), 0.02, 0.05, seed), step_across()) for seed in range(200)]
    assert 0.5 * depth_errors.CLEAN < np.mean(same) < 1.5 * depth_errors.CLEAN


def test_noise_stays_within_its_bound_and_differs_from_image_to_image() -> None:
    errors = []
    for seed in range(40):
        image = degraded(table(), 0.02, 0.0, seed)
        errors.append((image - table())[image > 0].std())
    assert max(errors) <= 0.02 * DIAMETER * 2.0
    assert np.std(errors) > 0.2 * np.mean(errors) and np.mean(errors) > 0.1 * 0.02 * DIAMETER


def test_noise_of_neighboring_pixels_is_correlated() -> None:
    near = []
    for seed in range(10):
        image = degraded(table(), 0.02, 0.0, seed)
        error = np.where(image > 0, image - table(), 0.0)
        near.append((error[:, 1:] * error[:, :-1]).mean() / np.square(error).mean())
    assert np.mean(near) > 0.2


def test_holes_stay_holes_and_new_ones_cover_no_more_than_their_share() -> None:
    depth = table()
    depth[10:20, 10:20] = 0.0
    shares = []
    for seed in range(20):
        holes = degraded(depth, 0.001, 0.2, seed) == 0
        assert holes[10:20, 10:20].all()
        shares.append(float(holes.mean()))
    assert 0.02 < np.mean(shares) < 0.25


def test_edges_lose_returns_beside_them_and_nothing_is_lost_far_away() -> None:
    lost = np.mean([degraded(step_across(), 1e-4, 0.0, seed) == 0 for seed in range(30)], 0)
    assert lost[:, 60:68].mean() > 0.1
    assert lost[:, :30].sum() == lost[:, 90:].sum() == 0


def test_a_second_eye_casts_its_shadow_on_the_far_side_of_an_edge_only() -> None:
    shadow = depth_errors._hidden_from(step_across(), np.float32(0.05 * FOCAL))
    other = depth_errors._hidden_from(step_across(), np.float32(-0.05 * FOCAL))
    columns = np.flatnonzero(shadow.any(0))
    wide = round(0.05 * FOCAL * (1 / 0.5 - 1 / 0.6))
    assert len(columns) == pytest.approx(wide, abs=1) and columns.max() == 63
    assert not other.any()


def test_some_pixels_have_the_depth_of_what_lies_beside_them() -> None:
    wrong = 0
    for seed in range(20):
        image = degraded(step_across(), 1e-4, 0.0, seed)
        wrong += int(((image > 0) & (np.abs(image - step_across()) > 0.01)).sum())
    assert wrong > 50


@pytest.mark.parametrize("image", [np.zeros((96, 128), np.float32), np.full((96, 128), 0.5, np.float32)])
@pytest.mark.parametrize("seed", range(4))
def test_an_image_of_holes_and_a_flat_one_stay_finite(image: np.ndarray, seed: int) -> None:
    result = degraded(image, 0.05, 0.3, seed)
    assert np.isfinite(result).all() and (result >= 0).all() and ((image > 0) | (result == 0)).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 50), (50, 1), (7, 9)])
def test_images_of_any_size_can_be_degraded(size: tuple[int, int]) -> None:
    for seed in range(5):
        assert degraded(np.full(size, 0.5, np.float32), 0.02, 0.1, seed).shape == size


def test_degrading_a_training_image_takes_milliseconds() -> None:
    image = step_across(240, 320)
    for seed in range(3):
        degraded(image, 0.015, 0.05, seed)
    started = time.process_time()
    for seed in range(20):
        degraded(image, 0.015, 0.05, seed)
    assert (time.process_time() - started) / 20 < 0.04


def test_shards_that_carry_a_sensors_errors_are_degraded_half_as_far(debug_shards: Path) -> None:
    class OfASensor(Frames):
        sensor = "stereo"  # type: ignore[assignment]

    config = preset("small").train
    ideal, noisy = (degradation_of(config, kind(debug_shards)) for kind in (Frames, OfASensor))
    assert Frames(debug_shards).sensor is None
    assert noisy == ideal.times(0.5) and all(ideal)
    assert not any(degradation_of(preset("paper").train, Frames(debug_shards)))


def test_labels_do_not_change_with_the_image(debug_shards: Path) -> None:
    frames = Frames(debug_shards)
    batches = Batches(frames, np.arange(6), preset("small").train, 0, ALONE)
    batch, plain = batches.load(0, torch.device("cpu")), frames.batch(batches.frame_numbers(0))
    assert not torch.equal(batch.depth, plain.depth)
    assert all(torch.equal(a, b) for a, b in zip(batch.poses, plain.poses, strict=True))
