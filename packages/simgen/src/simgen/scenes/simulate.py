"""One scene of a job: its instances at rest, simulated now or recorded earlier, and its cameras placed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.scene import Scene
from simgen.rendering.viewpoints import draw_viewpoints
from simgen.scenes.job import Job

Array = NDArray[np.float64]


def make_scene(job: Job, index: int) -> tuple[Scene, int]:
    """Scene number `index`, recorded or simulated now, and how many drops it took."""
    cam_from_world = None
    if job.recorded is None:
        world_from_obj, attempts = simulate_poses(job, index)
    else:
        world_from_obj, attempts, cam_from_world = job.recorded.scene(index)
    if cam_from_world is None:
        config, diameter = job.config, job.model.diameter
        cam_from_world = draw_viewpoints(
            config.viewpoints, config.camera, job.bin, diameter, config.seed, index, config.views
        )
    return Scene(index, world_from_obj, cam_from_world), attempts


def simulate_poses(job: Job, index: int) -> tuple[Array, int]:
    """`world_from_obj` (n, 4, 4) of scene number `index`, simulated now, and how many drops it took."""
    from simgen.physics.body import Body
    from simgen.physics.pile import simulate_pile  # only here: recorded scenes render without PyBullet

    config = job.config
    body = Body.from_parts(job.convex_parts, config.physics.simulated_diameter)
    instances = (config.instances_min, config.instances_max)
    pile = simulate_pile(body, job.scene_bin(index), instances, config.physics, config.seed, index, config.pile)
    return pile.world_from_obj, pile.attempts
