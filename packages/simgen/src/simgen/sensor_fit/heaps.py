"""Simulated heaps of a part, as a fitted sensor sees them from where the camera stood: the twin of the whole scene."""

from __future__ import annotations

import numpy as np

from evalkit.geometry.camera import Camera
from simgen.config import BuildConfig
from simgen.config_sections import ViewpointConfig
from simgen.objects.prepare import PreparedObject
from simgen.scenes.plan import plan
from simgen.scenes.render import SceneRenderer
from simgen.scenes.simulate import make_scene
from simgen.sensor_fit.frames import FitFrames
from simgen.sensor_fit.seen_surface import Image
from simgen.sensors.sensor_config import SensorConfig

SCENES, VIEWS = 3, 1
INSTANCES = (10, 20)
STEEPEST = 25.0  # degrees between the optical axis and the vertical
HEAP_SEED = 3


def heap_images(part: PreparedObject, frames: FitFrames, sensor: SensorConfig) -> tuple[list[Image], Camera]:
    """Depth images (H, W) in meters of simulated heaps, and their camera: of the same focal length, centered.

    Raises:
        InputError: from where the camera stood the part cannot be seen, or no heap fits before it.
    """
    cut = frames.camera
    camera = Camera(cut.width, cut.height, cut.fx, cut.fy, (cut.width - 1) / 2, (cut.height - 1) / 2)
    floor = frames.distances[1]
    config = BuildConfig(
        SCENES,
        VIEWS,
        *INSTANCES,
        camera,
        seed=HEAP_SEED,
        viewpoints=ViewpointConfig(max_tilt_degrees=STEEPEST),
        sensor=sensor,
    )
    job = plan(config, part.model, part.convex_parts, distances=(floor, floor))
    renderer, images = SceneRenderer(job), []
    for number in range(SCENES):
        scene, _ = make_scene(job, number)
        images += [(view.depth_raw * np.float32(job.depth_unit)).astype(np.float32) for view in renderer.views(scene)]
    return images, camera
