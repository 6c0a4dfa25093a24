"""A sensor fitted to images that a known sensor made is that sensor, and its twin shows what they show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from evalkit.geometry.camera import Camera
from simgen.sensor_fit.fit import FittedSensor, fit_sensor
from simgen.sensor_fit.fit_page import fit_page
from simgen.sensor_fit.frames import FitFrames, checked_frames
from simgen.sensor_fit.twin_agreement import rows
from simgen.sensors.sensor import measure, sensor_generator
from simgen.sensors.sensor_config import SensorConfig, kinect, stereo

Image = NDArray[np.float32]
NONE = SensorConfig("none", 0.06, 0.0, 0.0, 1e-4, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 89.9)
LEFT = replace(stereo(), baseline=-0.05, noise_blur=0.5, wrong_patches=0.0)


def taken(depths: list[Image], camera: Camera, sensor: SensorConfig, one_scene: bool = False) -> FitFrames:
    """What the sensor makes of the scenes, stored in tenths of a millimeter."""
    scenes = [depths[0]] * len(depths) if one_scene else depths
    measured = [measure(scene, camera, sensor, sensor_generator(9, i, 0)) for i, scene in enumerate(scenes)]
    stored = [(np.rint(depth / 1e-4) * np.float32(1e-4)).astype(np.float32) for depth in measured]
    return checked_frames([str(i) for i in range(len(stored))], stored, [camera] * len(stored), "images")


def require_found(fitted: FittedSensor, true: SensorConfig, camera: Camera) -> None:
    """Noise within 20 %, its blur within a half, missing within 3 and 20 points, steps within 3 %."""
    found = fitted.sensor
    scale = abs(true.baseline / found.baseline)  # errors of depth do not depend on it
    assert found.noise_px * scale == pytest.approx(true.noise_px, rel=0.2, abs=0.01)
    assert found.noise_blur == pytest.approx(true.noise_blur, abs=0.5) or true.noise_px == 0
    assert found.smooth_missing == pytest.approx(true.smooth_missing, abs=0.03)
    assert found.edge_missing == pytest.approx(true.edge_missing, abs=0.2)
    assert found.shadow_missing == pytest.approx(true.shadow_missing, abs=0.25)
    assert found.depth_step <= max(true.depth_step, 1e-4)
    if true.quantum_px / true.baseline > 1.0:
        assert found.quantum_px * scale == pytest.approx(true.quantum_px, rel=0.03)
    if true.noise_px == 0:
        return  # what the local fit then leaves is the shape's own detail, which the twin's smooth surface lacks
    differing = [row for row in rows(fitted.real, fitted.twin, camera.fx) if not row.agrees]
    assert not differing


@pytest.fixture(scope="module")
def stereo_fit(heaps: list[Image], camera: Camera) -> tuple[FitFrames, FittedSensor]:
    """Of three heaps."""
    frames = taken(heaps[:3], camera, stereo())
    return frames, fit_sensor(frames, stereo().baseline, "<mine>")


def test_a_known_sensor_is_found_again(stereo_fit: tuple[FitFrames, FittedSensor], camera: Camera) -> None:
    require_found(stereo_fit[1], stereo(), camera)


@pytest.mark.slow
@pytest.mark.parametrize("sensor", [NONE, kinect(), LEFT], ids=["none", "kinect", "left"])
def test_other_known_sensors_are_found_again(sensor: SensorConfig, heaps: list[Image], camera: Camera) -> None:
    require_found(fit_sensor(taken(heaps, camera, sensor), sensor.baseline), sensor, camera)


@pytest.mark.slow
@pytest.mark.parametrize("sensor", [stereo(), LEFT], ids=["stereo", "left"])
def test_the_baseline_is_found_by_the_shadows(sensor: SensorConfig, heaps: list[Image], camera: Camera) -> None:
    fitted = fit_sensor(taken(heaps, camera, sensor))
    assert fitted.sensor.baseline == pytest.approx(sensor.baseline, rel=0.4)


@pytest.mark.slow
def test_one_scene_several_times_serves_as_well(heaps: list[Image], camera: Camera) -> None:
    frames = taken(heaps, camera, stereo(), one_scene=True)
    fitted = fit_sensor(frames, stereo().baseline)
    require_found(fitted, stereo(), camera)
    assert fitted.twin.temporal == pytest.approx(fitted.real.temporal, rel=0.2)


def test_images_of_one_scene_are_told_from_those_of_several(heaps: list[Image], camera: Camera) -> None:
    assert taken(heaps, camera, stereo(), one_scene=True).static
    assert not taken(heaps, camera, stereo()).static


def test_the_page_shows_every_figure_of_both(stereo_fit: tuple[FitFrames, FittedSensor], camera: Camera) -> None:
    frames, fitted = stereo_fit
    page = fit_page(fitted, frames)
    assert "&lt;mine&gt;" in page and "<mine>" not in page
    for row in rows(fitted.real, fitted.twin, camera.fx):
        assert row.name in page
    assert page.count("data:image/svg+xml") == 7
