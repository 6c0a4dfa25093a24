"""Others that draw the same frames as simgen, with every instance's silhouette."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.scene import Scene
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from simgen.physics.bin_shape import bin_mesh
from simgen.rendering.renderers import DepthRenderer, depth_renderer
from simgen.scenes.job import Job

Array = NDArray[np.float64]


def report_peers(job: Job, scene: Scene, frames: int) -> None:
    """Others draw the same frames with every instance's silhouette; CPU time, all threads together."""
    if frames == 0:
        return
    cameras = scene.cam_from_world[:frames]
    ours = renderer_of(job)
    ours.set_background(*bin_mesh(job.scene_bin(scene.index)))
    mine = least_seconds(lambda: [ours.render(c @ scene.world_from_obj, c) for c in cameras], 3) / len(cameras)
    print(f"{len(cameras)} frames of {len(scene.world_from_obj)} instances with every whole silhouette, drawing alone")
    print(f"  {'simgen':<12}{1e3 * mine:8.1f} ms a frame")
    for name, start in (("embreex", start_embreex), ("pyrender", start_pyrender)):
        try:
            draw = start(job, scene)
        except (ImportError, InputError) as error:
            print(f"  {name:<12} left out: {error}")
            continue
        draw(cameras[0])
        theirs = least_seconds(lambda draw=draw: [draw(c) for c in cameras], 1) / len(cameras)  # type: ignore[misc]
        print(f"  {name:<12}{1e3 * theirs:8.1f} ms a frame, {theirs / mine:.0f} times ours")


def start_pyrender(job: Job, scene: Scene) -> Callable[[Array], object]:
    """pyrender's loop, as `simgen build --renderer pyrender` has it."""
    renderer = renderer_of(job, "pyrender")
    renderer.set_background(*bin_mesh(job.scene_bin(scene.index)))
    return lambda cam_from_world: renderer.render(cam_from_world @ scene.world_from_obj, cam_from_world)


def start_embreex(job: Job, scene: Scene) -> Callable[[Array], object]:
    """A ray through every pixel's center: at the whole scene, and at each instance alone within its window."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    def world_of(*meshes: tuple[Array, NDArray[np.int32]]) -> Any:
        world = rtcore_scene.EmbreeScene()
        for points, triangles in meshes:
            TriangleMesh(world, points[triangles].astype(np.float32))
        return world

    vertices, faces = job.model.mesh
    placed = [poses.apply(pose, vertices) for pose in scene.world_from_obj]
    everything = world_of(*((points, faces) for points in placed), bin_mesh(job.scene_bin(scene.index)))
    alone = [world_of((points, faces)) for points in placed]
    camera = job.config.camera
    rays = camera.point_map(np.ones((camera.height, camera.width)))

    def draw(cam_from_world: Array) -> list[Any]:
        world_from_cam = poses.invert(cam_from_world)
        directions = (rays @ world_from_cam[:3, :3].T).astype(np.float32)

        def trace(world: Any, rows: slice, columns: slice) -> Any:
            window = np.ascontiguousarray(directions[rows, columns].reshape(-1, 3))
            origins = np.broadcast_to(world_from_cam[:3, 3], window.shape).astype(np.float32)
            return world.run(origins, window, output=True)

        windows = [_window(camera, poses.apply(cam_from_world, points)) for points in placed]
        silhouettes = [trace(world, *window) for world, window in zip(alone, windows, strict=True)]
        return [trace(everything, slice(None), slice(None)), *silhouettes]

    return draw


def _window(camera: Camera, points: Array) -> tuple[slice, slice]:
    """Rows and columns of the frame that points (V, 3) before the camera project to."""
    pixels = camera.project(points)
    (u0, v0), (u1, v1) = np.floor(pixels.min(0)).astype(int), np.ceil(pixels.max(0)).astype(int) + 1
    return slice(max(0, v0), max(0, v1)), slice(max(0, u0), max(0, u1))


def least_seconds(work: Callable[[], Any], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        started = time.process_time()
        work()
        times.append(time.process_time() - started)
    return min(times)


def renderer_of(job: Job, name: str = "cpu") -> DepthRenderer:
    renderer = depth_renderer(name, job.config.camera, job.model.mesh)
    renderer.set_background(*bin_mesh(job.bin))
    return renderer
