"""Cameras: above the bin, looking at its middle, far enough and not too far."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from simgen.config_sections import BinSize, ViewpointConfig
from simgen.presets import PRESETS, default_camera
from simgen.rendering.viewpoints import at_distances, distance_range, draw_viewpoints, farthest_ground, max_tilt

CONFIG = ViewpointConfig()
CAMERAS = {
    "paper": default_camera(640, 480),
    "narrow": Camera(640, 480, 4000, 4000, 320, 240),
    "wide": Camera(64, 48, 5, 5, 32, 24),
    "off-axis": Camera(64, 48, 40, 40, 3, 24),
}
BINS = {
    "flat": BinSize(0.4, 0.3, 0.05),
    "deep": BinSize(0.3, 0.4, 0.9),
    "huge": BinSize(8, 6, 2),
    "tiny": BinSize(4e-3, 4e-3, 2e-3),
}


def tilts_of(cam_from_world: NDArray[np.float64]) -> NDArray[np.float64]:
    """Radians between optical axis and vertical."""
    return np.arccos(np.clip(-cam_from_world[:, 2, 2], -1, 1))


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("size", BINS.values(), ids=BINS)
def test_cameras_look_down_at_the_bins_middle_from_within_the_bounds(camera: Camera, size: BinSize) -> None:
    diameter = 0.3 * min(size.width, size.depth)
    cam_from_world = draw_viewpoints(CONFIG, camera, size, diameter, 0, 5, 200)
    assert poses.is_rotation(cam_from_world[:, :3, :3], 1e-9).all()
    middle = [(camera.width - 1) / 2, (camera.height - 1) / 2]
    assert np.allclose(camera.project(cam_from_world[:, :3, 3]), middle, atol=1e-6)
    position = poses.invert(cam_from_world)[:, :3, 3]
    distance = cam_from_world[:, 2, 3]
    nearest, farthest = distance_range(CONFIG, camera, size, diameter)
    assert (nearest - 1e-9 <= distance).all() and (distance <= farthest + 1e-9).all()
    tilt = tilts_of(cam_from_world)
    assert tilt.max() <= max_tilt(CONFIG, camera, size) + 1e-9 <= math.radians(CONFIG.max_tilt_degrees) + 2e-9
    assert (position[:, 2] > size.height + diameter).all(), "above the walls and above what sticks out of them"


def test_near_walls_leave_half_the_floor_in_sight() -> None:
    for size in BINS.values():
        hidden = size.height * math.tan(max_tilt(CONFIG, CAMERAS["paper"], size))
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


def test_tilts_keep_to_both_their_bounds() -> None:
    config = ViewpointConfig(min_tilt_degrees=20, max_tilt_degrees=40)
    tilt = np.degrees(tilts_of(draw_viewpoints(config, CAMERAS["paper"], BINS["flat"], 0.1, 0, 0, 300)))
    assert 20 - 1e-6 <= tilt.min() < 21 and 39 < tilt.max() <= 40 + 1e-6


def test_the_point_looked_at_scatters_over_its_share_of_the_bin() -> None:
    camera, size = CAMERAS["paper"], BINS["flat"]
    config = ViewpointConfig(look_at_jitter=0.2)
    world_from_cam = poses.invert(draw_viewpoints(config, camera, size, 0.1, 0, 0, 400))
    position, axis = world_from_cam[:, :3, 3], world_from_cam[:, :3, 2]  # its principal point is in the middle
    floor = position - axis * (position[:, 2] / axis[:, 2])[:, None]
    share = np.abs(floor[:, :2]) / [size.width, size.depth]
    assert share.max() <= 0.2 + 1e-9
    assert (share.max(0) > 0.19).all()


def test_turns_can_be_kept_to_where_rows_run_along_the_bins_width() -> None:
    config = ViewpointConfig(max_tilt_degrees=0, max_turn_degrees=10)
    cam_from_world = draw_viewpoints(config, CAMERAS["paper"], BINS["flat"], 0.1, 0, 0, 200)
    angle = np.degrees(np.arctan2(cam_from_world[:, 1, 0], cam_from_world[:, 0, 0]))
    assert 9 < np.abs(angle).max() <= 10 + 1e-6


@pytest.mark.parametrize("preset", ["default", "sileane", "icvl"])
def test_no_ground_in_sight_is_farther_than_its_bound(preset: str) -> None:
    config = PRESETS[preset]()
    camera, size = config.camera, BINS["flat"]
    _, farthest = distance_range(config.viewpoints, camera, size, 0.1)
    bound = farthest_ground(config.viewpoints, camera, size, farthest)
    world_from_cam = poses.invert(draw_viewpoints(config.viewpoints, camera, size, 0.1, 0, 0, 200))
    corners = camera.unproject([[u, v] for u in (0, camera.width - 1) for v in (0, camera.height - 1)], np.ones(4))
    slope = np.einsum("vk,ck->vc", world_from_cam[:, 2, :3], corners)
    depth = np.where(slope < 0, -world_from_cam[:, 2, 3, None] / slope, 0)
    assert depth.max() <= bound


def test_distances_in_meters_are_those_of_the_cameras_from_the_floor() -> None:
    camera, size, diameter = Camera(320, 240, 300.0, 300.0, 159.5, 119.5), BinSize(0.3, 0.2, 0.1), 0.08
    placed = at_distances(ViewpointConfig(max_tilt_degrees=20.0), camera, size, diameter, (0.45, 0.7))
    np.testing.assert_allclose(distance_range(placed, camera, size, diameter), (0.45, 0.7), rtol=1e-12)
    cam_from_world = draw_viewpoints(placed, camera, size, diameter, seed=3, scene=0, views=200)
    floor = np.linalg.norm(cam_from_world[:, :3, 3], axis=1)  # looking at the middle of the floor
    assert 0.45 <= floor.min() < 0.47 and 0.68 < floor.max() <= 0.7
    with pytest.raises(InputError, match=r"--distance 0\.1-0\.7.*among the parts"):
        at_distances(placed, camera, size, diameter, (0.1, 0.7))
