"""Our frames in the Siléane dataset's files (Brégier et al. 2017), which :mod:`evalkit.adapters.sileane` reads back.

::

    poseutils.json  mesh.obj  camera_params.txt
    gt/SSSSSS-VVV.json             R, t, occlusion_rate = 1 - returned visibility, segmentation_id
    depth/SSSSSS-VVV.PNG           16 bits between clip_start and clip_end
    segmentation/SSSSSS-VVV.PNG    16 bits, segmentation_id of the instance, 0 for the rest

A Siléane set has one camera at one place. Where ours stood in several, the world is taken to be the camera's frame. The
clipping planes are chosen such that a step of the image is a step of the shards, so that no depth is changed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.depth_images import HIGHEST, write_png
from evalkit.adapters.sileane.dataset import CAMERA_FILE
from evalkit.atomic import write_json, write_text
from evalkit.datasets.pose_rows import row_dicts
from evalkit.datasets.scene import View
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.meshes.write import write_obj
from evalkit.objects.model import ObjectModel

Array = NDArray[np.float64]


def write_dataset_files(
    folder: Path, model: ObjectModel, camera: Camera, depth_unit: float, cam_from_world: Array
) -> None:
    """Write what all images share: poseutils.json, mesh.obj and camera_params.txt, with the camera's pose (4, 4)."""
    if model.vertices is not None and model.faces is not None:
        write_obj(folder / "mesh.obj", model.vertices, model.faces)
    write_json(folder / "poseutils.json", _pose_utils(model), indent=1)
    write_text(folder / CAMERA_FILE, _camera_params(camera, depth_unit, cam_from_world))
    for name in ("gt", "depth", "segmentation"):
        (folder / name).mkdir(exist_ok=True)


def write_view(folder: Path, view: View, cam_from_world: Array) -> None:
    """Write one image and its labels, the labels last: where they lie, the image is complete."""
    write_png(folder / "depth" / f"{view.image_id}.PNG", view.depth_raw)
    write_png(folder / "segmentation" / f"{view.image_id}.PNG", view.instance_id)
    world_from_obj = poses.invert(cam_from_world) @ view.instances.cam_from_obj
    rows = row_dicts(world_from_obj, occlusion_rate=1.0 - view.instances.visibility("returned"))
    for row, instance in zip(rows, view.instances.instance.tolist(), strict=True):
        row["segmentation_id"] = instance + 1
    write_json(labels_path(folder, view.image_id), rows)


def labels_path(folder: Path, image_id: str) -> Path:
    return folder / "gt" / f"{image_id}.json"


def _pose_utils(model: ObjectModel) -> dict[str, Any]:
    """The object, in an inertial frame whose z is the axis of a revolution, as the toolbox wants it."""
    symmetry = model.symmetry
    turn = model.inertial_from_obj[:3, :3] if symmetry.kind == "finite" else symmetry.obj_from_sym.T
    document: dict[str, Any] = {
        "Rref2i": turn.tolist(),
        "tref2i": (-turn @ model.centroid).tolist(),
        "distance_threshold": model.threshold,
    }
    if symmetry.kind == "sphere":
        return {"type": "SphericalPoseUtils", **document}
    if symmetry.kind == "revolution":
        scale = symmetry.revolution_scale(model.lam_in_obj)
        return {"type": "RevolutionPoseUtils", "lambda": scale, "isFlip": symmetry.has_flip, **document}
    group = (turn @ symmetry.rotations @ turn.T).tolist()
    return {"type": "AffinePoseUtils", "Lambda": model.lam.tolist(), "G": group, **document}


def _camera_params(camera: Camera, depth_unit: float, cam_from_world: Array) -> str:
    world_from_cam = poses.invert(cam_from_world)
    x, y, z, w = poses.to_quaternion_xyzw(world_from_cam[:3, :3]).tolist()
    fields: dict[str, list[float]] = {
        "width": [camera.width],
        "height": [camera.height],
        "fu": [camera.fx],
        "fv": [camera.fy],
        "cu": [camera.cx],
        "cv": [camera.cy],
        "clip_start": [0.0],
        "clip_end": [HIGHEST * depth_unit],
        "location": (world_from_cam[:3, 3] + 0.0).tolist(),
        "rotation": [w, x, y, z],
    }
    return "".join("\t".join([key, *map(repr, values)]) + "\n" for key, values in fields.items())


def shared_view(cam_from_world: Array) -> Array:
    """The pose (4, 4) that all cameras (n, 4, 4) have, or else the identity: the world is the camera's frame."""
    same = np.allclose(cam_from_world, cam_from_world[:1], rtol=0, atol=1e-9)
    return np.asarray(cam_from_world[0] if same else np.eye(4))
