"""Where the cameras stand: on a cap of the upper hemisphere, all looking at the middle of the bin."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from evalkit import poses
from evalkit.camera import Camera
from simgen.config import BinSize, ViewpointConfig

Array = NDArray[np.float64]
VIEW_STAGE = 1  # second word of the spawn key; the drop uses another
HEADROOM = 1.5  # object diameters between the walls' top and the lowest camera
HIDDEN_FLOOR = 0.5  # share of the floor that the near wall may hide at the steepest tilt


def draw_viewpoints(
    config: ViewpointConfig, camera: Camera, size: BinSize, diameter: float, seed: int, scene: int, views: int
) -> Array:
    """`cam_from_world` (views, 4, 4): random direction on the cap, distance, and turn in the image plane."""
    return np.stack([
        _one_viewpoint(
            np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(scene, VIEW_STAGE, view))),
            max_tilt(config, size),
            distance_range(config, camera, size, diameter),
        )
        for view in range(views)
    ])  # fmt: skip


def max_tilt(config: ViewpointConfig, size: BinSize) -> float:
    """Largest angle in radians from the vertical: bounded for deep bins, whose walls would hide the floor."""
    over_the_wall = math.atan(HIDDEN_FLOOR * min(size.width, size.depth) / size.height)
    return min(math.radians(config.max_tilt_degrees), over_the_wall)


def distance_range(config: ViewpointConfig, camera: Camera, size: BinSize, diameter: float) -> tuple[float, float]:
    """Nearest and farthest distance in metres from the bin's middle; never among the instances."""
    half_view = min(camera.width / (2 * camera.fx), camera.height / (2 * camera.fy))
    fits = max(size.width, size.depth) / 2 / half_view + size.height
    clear = (size.height + HEADROOM * diameter) / math.cos(max_tilt(config, size))
    return max(config.nearest * fits, clear), max(config.farthest * fits, clear)


def _one_viewpoint(rng: np.random.Generator, tilt: float, distances: tuple[float, float]) -> Array:
    cosine = rng.uniform(math.cos(tilt), 1.0)  # uniform over the cap's area
    azimuth, turn = rng.uniform(0, 2 * math.pi, 2)
    distance = rng.uniform(*distances)
    sine = math.sqrt(1 - cosine * cosine)
    towards_camera = np.array([sine * math.cos(azimuth), sine * math.sin(azimuth), cosine])
    world_from_cam = poses.rotation_between([0.0, 0.0, 1.0], -towards_camera) @ poses.from_axis_angle([0, 0, 1.0], turn)
    return poses.invert(poses.from_rotation_translation(world_from_cam, distance * towards_camera))
