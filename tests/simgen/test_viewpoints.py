"""Cameras: above the bin, looking at its middle, far enough and not too far."""

from __future__ import annotations

import math

import numpy as np
import pytest

from evalkit import poses
from evalkit.camera import Camera
from simgen.config import BinSize, ViewpointConfig, default_camera
from simgen.viewpoints import distance_range, draw_viewpoints, max_tilt

CONFIG = ViewpointConfig()
CAMERAS = {
    "paper": default_camera(640, 480),
    "narrow": Camera(640, 480, 4000, 4000, 320, 240),
    "wide": Camera(64, 48, 5, 5, 32, 24),
}
BINS = {
    "flat": BinSize(0.4, 0.3, 0.05),
    "deep": BinSize(0.3, 0.4, 0.9),
    "huge": BinSize(8, 6, 2),
    "tiny": BinSize(4e-3, 4e-3, 2e-3),
}


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("size", BINS.values(), ids=BINS)
def test_cameras_look_down_at_the_bins_middle_from_within_the_bounds(camera: Camera, size: BinSize) -> None:
    diameter = 0.3 * min(size.width, size.depth)
    cam_from_world = draw_viewpoints(CONFIG, camera, size, diameter, 0, 5, 200)
    assert poses.is_rotation(cam_from_world[:, :3, :3], 1e-9).all()
    assert np.allclose(camera.project(cam_from_world[:, :3, 3]), [camera.cx, camera.cy], atol=1e-6)
    position = poses.invert(cam_from_world)[:, :3, 3]
    distance = np.linalg.norm(position, axis=1)
    nearest, farthest = distance_range(CONFIG, camera, size, diameter)
    assert (nearest - 1e-9 <= distance).all() and (distance <= farthest + 1e-9).all()
    tilt = np.arccos(position[:, 2] / distance)
    assert tilt.max() <= max_tilt(CONFIG, size) + 1e-9 <= math.radians(CONFIG.max_tilt_degrees) + 2e-9
    assert (position[:, 2] > size.height + diameter).all(), "above the walls and above what sticks out of them"


def test_near_walls_leave_half_the_floor_in_sight() -> None:
    for size in BINS.values():
        hidden = size.height * math.tan(max_tilt(CONFIG, size))
        assert hidden <= 0.5 * min(size.width, size.depth) + 1e-9


def test_turns_in_the_image_plane_are_uniform() -> None:
    cam_from_world = draw_viewpoints(CONFIG, CAMERAS["paper"], BINS["flat"], 0.1, 0, 0, 1000)
    up_in_image = cam_from_world[:, :2, 0]
    angle = np.arctan2(up_in_image[:, 1], up_in_image[:, 0])
    counts, _ = np.histogram(angle, bins=8, range=(-math.pi, math.pi))
    assert counts.min() > 85 and counts.max() < 165


def test_a_view_depends_on_its_scene_and_number_alone() -> None:
    arguments = (CONFIG, CAMERAS["paper"], BINS["flat"], 0.1, 3)
    many = draw_viewpoints(*arguments, 7, 17)
    assert np.array_equal(many[:4], draw_viewpoints(*arguments, 7, 4))
    assert len(np.unique(np.concatenate([many, draw_viewpoints(*arguments, 8, 17)])[:, 0, 0])) == 34
