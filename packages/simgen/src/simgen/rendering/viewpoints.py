"""Where the cameras stand: on a cap of the upper hemisphere, all looking at the middle of the bin, or near it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from simgen.config_sections import BinSize, ViewpointConfig

Array = NDArray[np.float64]
VIEW_STAGE = 1  # second word of the spawn key; the drop uses another
HEADROOM = 1.5  # object diameters between the walls' top and the lowest camera
HIDDEN_FLOOR = 0.5  # share of the floor that the near wall may hide at the steepest tilt
OVERHEAD = np.diag([1.0, -1.0, -1.0])  # world_from_cam looking straight down, image rows along the bin's width
SUNK = 0.5  # share of its height that a tilted camera may lose because its principal point is not in the middle


def draw_viewpoints(
    config: ViewpointConfig, camera: Camera, size: BinSize, diameter: float, seed: int, scene: int, views: int
) -> Array:
    """`cam_from_world` (views, 4, 4): random direction on the cap, distance, turn in the image plane, point looked at.

    It is the middle of the image that looks there, wherever the principal point is; the distance is along the axis.
    """
    rngs = [np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(scene, VIEW_STAGE, v))) for v in range(views)]
    if config.cam_from_table is not None:
        return np.stack([_on_measured_table(rng, config, size) for rng in rngs])
    tilts = (min(math.radians(config.min_tilt_degrees), max_tilt(config, camera, size)), max_tilt(config, camera, size))
    distances = distance_range(config, camera, size, diameter)
    return np.stack([_one_viewpoint(rng, config, camera, size, tilts, distances) for rng in rngs])


def max_tilt(config: ViewpointConfig, camera: Camera, size: BinSize) -> float:
    """Largest angle in radians from the vertical: bounded for deep bins, whose walls would hide the floor.

    That to a measured table is what it is.
    """
    if config.cam_from_table is not None:
        return math.acos(min(max(-config.cam_from_table[2][2], -1.0), 1.0))
    over_the_wall = math.atan(HIDDEN_FLOOR * min(size.width, size.depth) / size.height)
    off_axis = math.hypot(*_middle_ray(camera)[:2])
    above_the_pile = math.atan(SUNK / off_axis) if off_axis else math.pi / 2
    return min(math.radians(config.max_tilt_degrees), over_the_wall, above_the_pile)


def distance_range(config: ViewpointConfig, camera: Camera, size: BinSize, diameter: float) -> tuple[float, float]:
    """Nearest and farthest distance in meters from the bin's floor; never among the instances."""
    if config.cam_from_table is not None:
        return config.cam_from_table[2][3], config.cam_from_table[2][3]
    fits, clear = _fitting_distance(camera, size), _clear_distance(config, camera, size, diameter)
    return max(config.nearest * fits, clear), max(config.farthest * fits, clear)


def at_distances(
    config: ViewpointConfig, camera: Camera, size: BinSize, diameter: float, distances: tuple[float, float]
) -> ViewpointConfig:
    """The config whose cameras stand `distances` (nearest, farthest) meters from the bin's floor.

    Raises:
        InputError: that near they would stand among the instances.
    """
    clear = _clear_distance(config, camera, size, diameter)
    if distances[0] < clear:
        raise InputError(
            f"--distance {distances[0]:g}-{distances[1]:g}: that near, cameras would stand among the parts; from "
            f"{clear:.3g} m on they clear the bin. Give meters from its floor, or a lower --bin."
        )
    fits = _fitting_distance(camera, size)
    return replace(config, nearest=distances[0] / fits, farthest=distances[1] / fits)


def _fitting_distance(camera: Camera, size: BinSize) -> float:
    """Meters from the floor at which the bin's opening just fits the image's narrower side."""
    half_view = min(camera.width / (2 * camera.fx), camera.height / (2 * camera.fy))
    return max(size.width, size.depth) / 2 / half_view + size.height


def _clear_distance(config: ViewpointConfig, camera: Camera, size: BinSize, diameter: float) -> float:
    """Meters from the floor from which on a camera is above the instances, however tilted."""
    tilt, off_axis = max_tilt(config, camera, size), math.hypot(*_middle_ray(camera)[:2])
    return (size.height + HEADROOM * diameter) / (math.cos(tilt) - off_axis * math.sin(tilt))


def farthest_ground(config: ViewpointConfig, camera: Camera, size: BinSize, farthest: float) -> float:
    """A bound in meters on the axial depth of ground seen from the `farthest` distance, infinite above the horizon."""
    corners = camera.unproject([[u, v] for u in (0, camera.width - 1) for v in (0, camera.height - 1)], np.ones(4))
    off_axis = float(np.linalg.norm(corners[:, :2], axis=1).max())
    steepest = max_tilt(config, camera, size) + math.atan(off_axis)
    if steepest >= math.pi / 2:
        return math.inf
    return farthest * (1 + math.hypot(*_middle_ray(camera)[:2])) / math.cos(steepest)


def require_clear_table(config: ViewpointConfig, size: BinSize, diameter: float) -> None:
    """Refuse a table measured so near that the camera would stand among the instances.

    Raises:
        InputError: with the height that clears the bin.
    """
    if config.cam_from_table is None:
        return
    height, clear = float(poses.invert(np.array(config.cam_from_table))[2, 3]), size.height + HEADROOM * diameter
    if height < clear:
        raise InputError(
            f"--table: the camera stands {height:.3g} m above it, among the parts; from {clear:.3g} m on it clears the "
            "bin. Give meters, or a lower --bin."
        )


def _on_measured_table(rng: np.random.Generator, config: ViewpointConfig, size: BinSize) -> Array:
    """`cam_from_world` (4, 4) of a bin that is turned, and put aside, on the measured table."""
    assert config.cam_from_table is not None, "the table was measured"
    turn = math.radians(config.max_turn_degrees) * rng.uniform(-1, 1)
    aside = rng.uniform(-1, 1, 2) * config.look_at_jitter * (size.width, size.depth)
    table_from_world = poses.from_rotation_translation(poses.from_axis_angle([0, 0, 1.0], turn), np.append(-aside, 0.0))
    return poses.compose(np.array(config.cam_from_table), table_from_world)


def _one_viewpoint(
    rng: np.random.Generator,
    config: ViewpointConfig,
    camera: Camera,
    size: BinSize,
    tilts: tuple[float, float],
    distances: tuple[float, float],
) -> Array:
    cosine = rng.uniform(math.cos(tilts[1]), math.cos(tilts[0]))  # uniform over the cap's area
    azimuth, turn = rng.uniform(-math.pi, math.pi, 2) * (1.0, config.max_turn_degrees / 180)
    distance = rng.uniform(*distances)
    aside = rng.uniform(-1, 1, 2) * config.look_at_jitter * (size.width, size.depth)
    sine = math.sqrt(1 - cosine * cosine)
    axis = -np.array([sine * math.cos(azimuth), sine * math.sin(azimuth), cosine])
    turned = poses.compose(OVERHEAD, poses.from_axis_angle([0, 0, 1.0], turn))
    world_from_cam = poses.compose(poses.rotation_between([0.0, 0.0, -1.0], axis), turned)
    position = np.append(aside, 0.0) - distance * poses.compose(world_from_cam, _middle_ray(camera)[:, None])[:, 0]
    return poses.invert(poses.from_rotation_translation(world_from_cam, position))


def _middle_ray(camera: Camera) -> Array:
    """Direction (3,) of the middle of the image, camera frame, z = 1."""
    return camera.unproject([(camera.width - 1) / 2, (camera.height - 1) / 2], 1.0)
