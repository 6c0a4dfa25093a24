"""What a sensor can be fitted to, and the sentences on what it cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from simgen.sensor_fit.frames import checked_frames
from simgen.sensor_fit.quantization import depth_step, inverse_step

Image = NDArray[np.float32]


def check(depths: list[Image], camera: Camera) -> None:
    checked_frames([f"image-{i}" for i in range(len(depths))], depths, [camera] * len(depths), "folder")


def test_fewer_than_three_images_are_too_few(heaps: list[Image], camera: Camera) -> None:
    with pytest.raises(InputError, match=r"folder: holds 2 depth images.*at least 3"):
        check(heaps[:2], camera)


def test_images_of_different_sizes_or_cameras_are_refused(heaps: list[Image], camera: Camera) -> None:
    with pytest.raises(InputError, match=r"'image-2' is of another size"):
        check([*heaps[:2], heaps[2][:100]], camera)
    cameras = [camera, camera, replace(camera, fx=200.0)]
    with pytest.raises(InputError, match=r"'c' is of another size or camera than 'a'"):
        checked_frames(["a", "b", "c"], heaps[:3], cameras, "folder")


def test_empty_and_saturated_images_are_refused(heaps: list[Image], camera: Camera) -> None:
    with pytest.raises(InputError, match=r"'image-1' is empty"):
        check([heaps[0], np.zeros_like(heaps[0]), heaps[2]], camera)
    with pytest.raises(InputError, match=r"'image-2' holds the same depth, 65.535 m, in most pixels"):
        check([*heaps[:2], np.full_like(heaps[0], 65.535)], camera)


def test_images_are_cut_to_what_they_show_with_the_camera_that_goes_with_it(heaps: list[Image], camera: Camera) -> None:
    cut = [np.where(np.arange(320) > 100, depth, 0).astype(np.float32) for depth in heaps]
    frames = checked_frames(["a", "b", "c", "d"], cut, [camera] * 4, "folder")
    assert frames.depths[0].shape == (frames.camera.height, frames.camera.width) and frames.camera.width < 320
    point = camera.unproject([200.0, 100.0], 0.5)
    assert np.allclose(frames.camera.project(point)[0], 200.0 - (320 - frames.camera.width))


@pytest.mark.parametrize("step", [1e-4, 1e-3, 2.5e-3])
def test_steps_of_depth_are_found(step: float) -> None:
    values = np.random.default_rng(0).uniform(0.4, 0.6, 20_000)
    assert depth_step(np.rint(values / step) * step) == pytest.approx(step)
    assert depth_step(values) == 0


@pytest.mark.parametrize("step", [0.8, 2.0, 5.0])
def test_steps_of_disparity_are_found_through_the_step_of_the_stored_depth(step: float) -> None:
    q = np.random.default_rng(0).uniform(500.0, 900.0, 30_000)  # fx / z, fx 300
    stored = np.rint(300.0 / (np.rint(q / step) * step) / 1e-4) * 1e-4
    assert inverse_step(300.0 / stored, 1e-4, 300.0) == pytest.approx(step, rel=0.02)
    assert inverse_step(q, 1e-4, 300.0) == 0
