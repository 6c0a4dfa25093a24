"""Scenes that somebody published as poses: a folder in the Siléane dataset's format, to be rendered anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.sileane import dataset as sileane
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.meshes.read import FORMATS, read_mesh
from evalkit.objects.model import ObjectModel
from simgen.config import BuildConfig
from simgen.config_sections import BinSize
from simgen.physics.bin_shape import ground_half_side
from simgen.scenes.identity import fingerprint
from simgen.scenes.job import Job
from simgen.scenes.plan import depth_unit_for
from simgen.scenes.recorded import RecordedScenes

Array = NDArray[np.float64]


def job_of_layouts(folder: Path) -> Job:
    """The job that renders FOLDER/gt/*.json as FOLDER/camera_params.txt sees them, an image a scene.

    Instances keep their order, and scenes that of their names, which the header's config lists. No walls: the folder
    states none. The ground is the world's z = 0, or lower, in all scenes, where an instance of any reaches below it.

    Raises:
        InputError: a file is missing or is not what it should be.
    """
    if not (folder / "gt").is_dir() or not (folder / sileane.CAMERA_FILE).is_file():
        raise InputError(
            f"{folder}: a folder of scenes to render needs gt/*.json, {sileane.CAMERA_FILE}, poseutils.json and "
            "mesh.obj, as the Siléane dataset has them; give such a folder, or a file of 'simgen simulate'."
        )
    model = _with_mesh(sileane.read_object(folder), folder)
    truth = sileane.read_ground_truth(folder)
    camera, cam_from_world = sileane.read_camera_params(folder / sileane.CAMERA_FILE)
    cam_from_world = _rigid(cam_from_world)
    world_from_obj = [_rigid(poses.compose(poses.invert(cam_from_world), image.cam_from_obj)) for image in truth.images]
    world_from_obj, cam_from_world = _on_the_ground(model, world_from_obj, cam_from_world)
    counts = [len(scene) for scene in world_from_obj]
    size = _ground(model, world_from_obj)
    config = BuildConfig(len(counts), 1, max(1, min(counts)), max(1, *counts), camera, bin=size)
    geometry: list[tuple[NDArray[Any], ...]] = [model.mesh, *((scene, cam_from_world) for scene in world_from_obj)]
    recorded = RecordedScenes(
        first=0,
        world_from_obj=world_from_obj,
        attempts=[1] * len(counts),
        origin={
            "geometry_sha256": fingerprint(geometry),
            "layouts": {"format": "sileane", "scenes": [image.id for image in truth.images]},
        },
        software={},
        cam_from_world=[cam_from_world[None]] * len(counts),
    )
    unit = depth_unit_for(_farthest(camera, cam_from_world, world_from_obj, model, size), model.diameter)
    return Job(config, model, [], unit, recorded)


def with_options(job: Job, config: BuildConfig) -> Job:
    """The job of some layouts with another sensor, renderer or packing.

    Raises:
        InputError: the config has another camera or more views, which the folder states, or the sensor does not suit.
    """
    allowed = replace(
        job.config,
        sensor=config.sensor, keep_ideal=config.keep_ideal, renderer=config.renderer,
        compression=config.compression, shard_scenes=config.shard_scenes,
    )  # fmt: skip
    if allowed != config:
        raise InputError(
            "the folder gives the camera and where it stands; leave out --camera, --width, --height, --views, "
            "--tilt, --distance, --table and --look-at-jitter."
        )
    if config.sensor is not None:
        config.sensor.require_range(config.camera, nearest_and_farthest(job)[0])
    return replace(job, config=config)


def nearest_and_farthest(job: Job) -> tuple[float, float]:
    """Smallest and largest axial distance in meters at which an instance may be seen."""
    recorded, radius = job.recorded, job.model.diameter / 2
    if recorded is None or recorded.cam_from_world is None:
        raise ValueError("the job's cameras are not recorded")
    pairs = zip(recorded.cam_from_world, recorded.world_from_obj, strict=True)
    depth = np.concatenate([job.model.centers(poses.compose(camera, scene))[:, 2] for camera, scene in pairs])
    return max(float(depth.min(initial=np.inf)) - radius, 1e-3), float(depth.max(initial=0.0)) + radius


def _with_mesh(model: ObjectModel, folder: Path) -> ObjectModel:
    """The object with the mesh of the folder, which may be other than an OBJ file."""
    if model.vertices is not None:
        return model
    for extension in FORMATS:
        path = folder / f"mesh.{extension}"
        if path.is_file():
            vertices, faces = read_mesh(path)
            return replace(model, vertices=vertices, faces=faces.astype(np.int32))
    raise InputError(f"{folder}: holds no mesh of the object; put it there as mesh.obj, in meters.")


def _rigid(transform: Array) -> Array:
    """Transforms (..., 4, 4) with the rotation nearest to theirs: published numbers are rounded."""
    return poses.from_rotation_translation(poses.nearest_rotation(transform[..., :3, :3]), transform[..., :3, 3])


def _on_the_ground(
    model: ObjectModel, world_from_obj: Sequence[Array], cam_from_world: Array
) -> tuple[list[Array], Array]:
    """The same scenes in a world whose ground z = 0 is below all instances."""
    vertices, _ = model.mesh
    lowest = min(float(poses.apply(scene, vertices[None])[..., 2].min(initial=0.0)) for scene in world_from_obj)
    lift = poses.from_rotation_translation(np.eye(3), [0.0, 0.0, max(0.0, -lowest)])
    return [poses.compose(lift, scene) for scene in world_from_obj], poses.compose(cam_from_world, poses.invert(lift))


def _ground(model: ObjectModel, world_from_obj: Sequence[Array]) -> BinSize:
    """A bin without walls around all instances."""
    centers = np.concatenate([np.zeros((1, 3)), *(model.centers(scene) for scene in world_from_obj)])
    x, y = 2 * np.abs(centers[:, :2]).max(0) + model.diameter
    return BinSize(float(x), float(y), float(centers[:, 2].max()) + model.diameter, walls=False)


def _farthest(
    camera: Camera, cam_from_world: Array, world_from_obj: Sequence[Array], model: ObjectModel, size: BinSize
) -> float:
    """Largest axial depth in meters that is to be stored: of the instances, and of what ground the image shows."""
    instances = max(
        float(model.centers(poses.compose(cam_from_world, scene))[:, 2].max(initial=0.0)) for scene in world_from_obj
    )
    pixels = [[u, v] for u in (0, camera.width - 1) for v in (0, camera.height - 1)]
    world_from_cam = poses.invert(cam_from_world)
    rays = camera.unproject(pixels, np.ones(4))
    slope = poses.compose(rays, world_from_cam[:3, :3].T)  # of each corner's ray, per axial meter
    half = ground_half_side(size)
    edge = np.array([[x, y, 0.0] for x in (-half, half) for y in (-half, half)])
    ground = float(poses.apply(cam_from_world, edge)[:, 2].max())
    if (slope[:, 2] < 0).all():
        ground = min(ground, float((-world_from_cam[2, 3] / slope[:, 2]).max()))
    return max(instances + model.diameter, ground)
