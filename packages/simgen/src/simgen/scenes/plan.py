"""From a config and an object to a job: the bin, where it is automatic, and the depth unit are settled."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from simgen.config import BuildConfig
from simgen.physics.bin_shape import ground_half_side
from simgen.physics.bin_size import fitting_bin, require_room
from simgen.rendering.viewpoints import at_distances, distance_range, farthest_ground, require_clear_table
from simgen.scenes.job import Job, Part
from simgen.scenes.recorded import RecordedScenes

DEPTH_UNIT = 1e-4  # meters, unless the scene is much larger or smaller than a table
STEPS_PER_DIAMETER = 500  # 0.1 mm will do for objects of 5 cm and more
MIN_STEPS_PER_DIAMETER = 50
STEPS = np.iinfo(np.uint16).max
MIN_PIXELS = 4


def plan(
    config: BuildConfig,
    model: ObjectModel,
    convex_parts: list[Part],
    recorded: RecordedScenes | None = None,
    distances: tuple[float, float] | None = None,
) -> Job:
    """Settle what depends on the object's size: the bin, where it is automatic, the distances and the depth unit.

    Args:
        distances: nearest and farthest of the cameras from the bin's floor in meters, in place of the config's.

    Raises:
        InputError: the object is larger than the bin, or the camera cannot see it or would stand among the parts.
    """
    size = config.bin or fitting_bin(model.mesh[0], model.diameter, config.instances_max, config.pile)
    require_room(config.pile, size, model, config.instances_max)
    edge = math.sqrt(2) * (1 + config.pile.bin_jitter) * ground_half_side(size)
    config = replace(config, bin=size)
    if distances is not None:
        config = replace(
            config, viewpoints=at_distances(config.viewpoints, config.camera, size, model.diameter, distances)
        )
    require_clear_table(config.viewpoints, size, model.diameter)
    nearest, farthest = distance_range(config.viewpoints, config.camera, size, model.diameter)
    ground = farthest_ground(config.viewpoints, config.camera, size, farthest)
    _require_sight(config.camera, model.diameter, farthest)
    if config.sensor is not None:
        config.sensor.require_range(config.camera, nearest)
    aside = config.viewpoints.look_at_jitter * math.hypot(size.width, size.depth)
    unit = depth_unit_for(min(farthest + aside + edge, ground), model.diameter)
    return Job(config, model, convex_parts, unit, recorded)


def camera_distances(job: Job) -> tuple[float, float]:
    """Nearest and farthest distance in meters of the cameras from the bin's middle."""
    return distance_range(job.config.viewpoints, job.config.camera, job.bin, job.model.diameter)


def depth_unit_for(farthest: float, diameter: float) -> float:
    """Meters a step: 0.1 mm, or the power of ten that reaches `farthest` in 16 bits where 0.1 mm is too fine or coarse.

    Raises:
        InputError: from that far 16 bits cannot resolve the object.
    """
    if farthest <= STEPS * DEPTH_UNIT and diameter >= STEPS_PER_DIAMETER * DEPTH_UNIT:
        return DEPTH_UNIT
    unit = float(f"1e{math.ceil(math.log10(farthest / STEPS))}")
    if diameter < MIN_STEPS_PER_DIAMETER * unit:
        raise InputError(
            f"--camera: it would stand {farthest:.3g} m off to see the whole bin, too far for an object of "
            f"{diameter:.3g} m in 16 bits of depth; give a shorter focal length in pixels, or a smaller --bin."
        )
    return unit


def _require_sight(camera: Camera, diameter: float, farthest: float) -> None:
    """Raise InputError unless the camera looks at the bin and shows the object in enough pixels."""
    if not (0 <= camera.cx <= camera.width - 1 and 0 <= camera.cy <= camera.height - 1):
        raise InputError(
            f"--camera: its principal point ({camera.cx:g}, {camera.cy:g}) lies outside the image, "
            "so that it would not see the bin that it is aimed at; give cx and cy within the image, in pixels."
        )
    pixels = min(camera.fx, camera.fy) * diameter / farthest
    if pixels < MIN_PIXELS:
        raise InputError(
            f"--camera: the object would be only {pixels:.1f} pixels across; "
            "give more pixels, a longer focal length in pixels, or a smaller --bin."
        )
