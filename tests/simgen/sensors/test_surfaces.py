"""Shiny, dark and translucent surfaces: what they lose and bend, by how they are inclined and curved."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from evalkit.geometry.camera import Camera
from simgen.sensors.sensor import measure
from simgen.sensors.sensor_config import SensorConfig, stereo
from simgen.sensors.sensor_text import SURFACES, parse_sensor

CAMERA = Camera(200, 160, 400.0, 400.0, 99.5, 79.5)
PERFECT = SensorConfig("perfect", 0.06, 0.0, 0.0, 1e-4, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 89.9)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def plane(degrees: float, z: float = 0.6) -> NDArray[np.float32]:
    across = (np.arange(CAMERA.width) - CAMERA.cx) / CAMERA.fx
    return np.tile(z / (1 - math.tan(math.radians(degrees)) * across), (CAMERA.height, 1)).astype(np.float32)


def cylinder(radius: float, z: float = 0.6, hollow: bool = False) -> NDArray[np.float32]:
    """A cylinder along the image's columns, its nearest (or farthest) line at depth z."""
    across = (np.arange(CAMERA.width) - CAMERA.cx) / CAMERA.fx
    middle = z - radius if hollow else z + radius
    a, b, c = across**2 + 1, -2 * middle, middle**2 - radius**2
    root = np.sqrt(np.maximum(b * b - 4 * a * c, 0))
    return np.tile((-b + (root if hollow else -root)) / (2 * a), (CAMERA.height, 1)).astype(np.float32)


@pytest.mark.parametrize("degrees", [20.0, 50.0, 70.0])
def test_inclined_surfaces_lose_as_many_returns_as_the_formula_says(degrees: float) -> None:
    sensor = replace(PERFECT, fade_degrees=50.0, fade_width_degrees=8.0)
    lost = np.mean([measure(plane(degrees), CAMERA, sensor, rng(i))[:, 95:105] == 0 for i in range(30)])
    assert lost == pytest.approx(1 / (1 + math.exp((50.0 - degrees) / 8.0)), abs=0.07)


def test_glare_loses_what_faces_the_camera() -> None:
    lost = measure(plane(0.0), CAMERA, replace(PERFECT, glare_degrees=5.0), rng()) == 0
    assert lost.all()
    assert not (measure(plane(10.0), CAMERA, replace(PERFECT, glare_degrees=5.0), rng())[:, 90:110] == 0).any()


def test_mirrors_bend_convex_surfaces_away_and_hollow_ones_toward_the_camera_and_leave_planes() -> None:
    sensor, middle = replace(PERFECT, mirror_share=0.3, bend_most=0.02), np.s_[40:120, 99:101]
    for radius in (0.01, 0.03):
        away = (measure(cylinder(radius), CAMERA, sensor, rng()) - cylinder(radius))[middle].mean()
        # the mean curvature of a cylinder is half that of its section: an image at `radius` behind it
        assert away == pytest.approx(0.3 * radius if radius <= 0.02 else 0.3 * 0.02**2 / radius, rel=0.1)
    toward = (measure(cylinder(0.05, hollow=True), CAMERA, sensor, rng()) - cylinder(0.05, hollow=True))[middle]
    assert toward.mean() < -1e-3
    for degrees in (0.0, 40.0):
        bent = measure(plane(degrees), CAMERA, sensor, rng()) - plane(degrees)
        assert np.abs(bent[10:-10, 90:110]).max() < 5e-4


@pytest.mark.parametrize("radius", [1e-3, 0.01, 0.1, 1.0])
def test_no_mirror_bends_farther_than_its_bound(radius: float) -> None:
    sensor = replace(PERFECT, mirror_share=1.0, bend_most=0.004)
    depth = cylinder(radius)
    error = np.abs(measure(depth, CAMERA, sensor, rng()) - depth)
    assert error[depth > 0].max() < 0.0042


def test_translucent_surfaces_appear_beneath_themselves_the_more_the_steeper() -> None:
    sensor = replace(PERFECT, penetration=0.002)
    facing, inclined = (
        (measure(plane(degrees), CAMERA, sensor, rng()) - plane(degrees))[40:120, 99:101].mean() for degrees in (0, 60)
    )
    assert facing == pytest.approx(0.002, rel=0.05)
    inside = math.sqrt(1 - math.sin(math.radians(60)) ** 2 / 1.5**2)
    assert inclined == pytest.approx(0.002 * inside / 0.5, rel=0.05)


@pytest.mark.parametrize("surface", SURFACES)
def test_surfaces_are_given_by_name_and_what_follows_them_wins(surface: str) -> None:
    assert parse_sensor(f"stereo,{surface}") == replace(stereo(), **SURFACES[surface])
    assert parse_sensor(f"stereo,{surface},fade_degrees=33") == replace(
        stereo(), **SURFACES[surface] | {"fade_degrees": 33.0}
    )
    depth = cylinder(0.03)
    plain, surfaced = (measure(depth, CAMERA, parse_sensor(text), rng(1)) for text in ("stereo", f"stereo,{surface}"))
    assert (surfaced == 0).sum() > (plain == 0).sum() + 100


def test_the_second_eye_may_be_on_the_left() -> None:
    depth = plane(0.0, 0.9)
    depth[50:100, 80:120] = 0.6
    right = measure(depth, CAMERA, replace(PERFECT, shadow_missing=1.0), rng()) == 0
    mirrored = depth[:, ::-1].copy()
    left = measure(mirrored, CAMERA, replace(PERFECT, shadow_missing=1.0, baseline=-0.06), rng()) == 0
    assert right.any() and np.array_equal(left[:, ::-1], right)


def test_delivered_depth_comes_in_its_own_steps() -> None:
    depth = measure(plane(30.0), CAMERA, replace(stereo(), depth_step=0.001), rng())
    steps = depth[depth > 0] / 1e-3
    assert np.allclose(steps, np.round(steps), atol=1e-3)


@pytest.mark.parametrize(("blur", "expected"), [(0.0, 0.0), (0.5, 0.41), (2.0, 0.69)])
def test_noise_reaches_as_far_as_its_blur(blur: float, expected: float) -> None:
    sensor = replace(PERFECT, noise_px=0.1, noise_blur=blur)
    error = measure(plane(0.0), CAMERA, sensor, rng()) - 0.6
    assert error.std() == pytest.approx(sensor.sigma(CAMERA, 0.6), rel=0.15)
    assert np.mean(error[:, 1:] * error[:, :-1]) / error.var() == pytest.approx(expected, abs=0.12)
