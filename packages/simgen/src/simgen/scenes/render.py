"""From a scene to its labeled views: drawn, measured by the sensor, labeled. Needs no physics."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from evalkit.datasets.scene import Scene, View
from evalkit.geometry import poses
from simgen.physics.bin_shape import bin_mesh
from simgen.rendering.labels import label_instances, quantized
from simgen.rendering.renderers import depth_renderer
from simgen.rendering.viewpoints import draw_viewpoints
from simgen.scenes.distractors import Mesh, joined, put_distractors
from simgen.scenes.job import Job
from simgen.sensors.sensor import measure, sensor_generator


class SceneRenderer:
    """Turns the scenes of a job into labeled views."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._renderer = depth_renderer(job.config.renderer, job.config.camera, job.model.mesh)

    def views(self, scene: Scene) -> Iterator[View]:
        """The scene's frames, one for each of its cameras."""
        config, model, unit = self._job.config, self._job.model, self._job.depth_unit
        self._renderer.set_background(*self._background(scene))
        for view, cam_from_world in enumerate(scene.cam_from_world):
            cam_from_obj = poses.compose(cam_from_world, scene.world_from_obj)
            rendering = self._renderer.render(cam_from_obj, cam_from_world)
            depth = rendering.depth
            if config.sensor is not None:
                rng = sensor_generator(config.seed, scene.index, view)
                depth = measure(depth, config.camera, config.sensor, rng)
            depth_raw = quantized(depth, unit)
            yield View(
                camera=config.camera,
                depth_raw=depth_raw,
                depth_unit=unit,
                instance_id=rendering.instance_id,
                cam_from_world=cam_from_world,
                instances=label_instances(rendering, depth_raw, cam_from_obj, model, config.camera),
                scene_index=scene.index,
                view_index=view,
                depth_ideal_raw=quantized(rendering.depth, unit) if config.keep_ideal else None,
            )

    def _background(self, scene: Scene) -> Mesh:
        """What is no instance: the bin, and foreign things."""
        job, size = self._job, self._job.scene_bin(scene.index)
        bin_itself, found = bin_mesh(size), job.config.distractors
        if found is None:
            return bin_itself
        where = (size, job.model.diameter, job.config.seed, scene.index)
        put = put_distractors(job.foreign_things, found.share, job.model.mesh, scene.world_from_obj, *where)
        return joined([bin_itself, *put])


def compile_renderer(job: Job) -> None:
    """Render one instance here, so that the workers find the compiled code instead of each compiling it."""
    renderer, config = SceneRenderer(job), job.config
    camera = draw_viewpoints(config.viewpoints, config.camera, job.bin, job.model.diameter, seed=0, scene=0, views=1)
    for _ in renderer.views(Scene(0, np.eye(4)[None], camera)):
        pass
