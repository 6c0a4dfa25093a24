"""Ideal depth images of scenes that need no physics: bricks and cups at random above a table."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from simgen.objects.builtin import BUILTIN_OBJECTS
from simgen.rendering.rasterizer import Rasterizer

Image = NDArray[np.float32]
CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)
TABLE = (np.array([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def scene(number: int) -> Image:
    vertices, faces = BUILTIN_OBJECTS["brick" if number % 2 else "cup"].make()
    renderer = Rasterizer(CAMERA, vertices * (0.09 / np.ptp(vertices, axis=0).max()), faces.astype(np.int32), TABLE)
    rng = np.random.default_rng(number)
    above = poses.from_rotation_translation(poses.from_axis_angle([1.0, 0.3, 0.0], np.pi - 0.25), [0, 0, 0.55])
    places = np.column_stack([rng.uniform(-0.25, 0.25, (28, 2)), rng.uniform(0.02, 0.12, 28)])
    lying = poses.from_rotation_translation(poses.random_rotations(rng, 28), places)
    return renderer.render(above @ lying, above).depth


@pytest.fixture(scope="session")
def heaps() -> list[Image]:
    """Four scenes (240, 320) seen by CAMERA, in meters."""
    return [scene(number) for number in range(4)]


@pytest.fixture(scope="session")
def camera() -> Camera:
    return CAMERA
