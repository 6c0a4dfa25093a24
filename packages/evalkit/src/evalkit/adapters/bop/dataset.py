"""The BOP benchmark's datasets (Hodaň et al. 2018), scene-wise format: millimeters and OpenCV axes in, meters out.

``SPLIT/000001/scene_gt.json`` holds the poses, ``scene_gt_info.json`` the visible fractions, ``scene_camera.json`` the
intrinsics and the depth's scale, ``models*/`` beside the split the objects. Sets of several sensors add the sensor's
name to all of them (``scene_gt_cam1.json``). An image is known as scene and image number, ``000001-000003``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.bop.mesh_frame import read_origin, truth_in_mesh_frame
from evalkit.adapters.bop.object import METERS, models_info, read_object
from evalkit.adapters.bop.scenes import Scene, dataset_folder, find_scenes
from evalkit.adapters.bop.target_lists import Targets, read_targets
from evalkit.adapters.depth_images import DepthImage
from evalkit.adapters.fields import checked_poses, image_id, numbers
from evalkit.adapters.visibility import SYNTAX, Visibility
from evalkit.datasets.documents import GroundTruth, GroundTruthImage
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.image_file import image_size
from evalkit.json_file import load_json
from evalkit.objects.model import ObjectModel

Array = NDArray[np.float64]
NEAREST = 0.01  # meters; a camera sees nothing nearer, but meters read as millimeters lie there …
NEAREST_SHARE = 0.25  # … or within this share of the object's diameter, for its origin is not its center


def read_ground_truth(
    folder: Path,
    *,
    object_id: int | None = None,
    object_name: str | None = None,
    mesh: Path | None = None,
    units: str | None = None,
    symmetry: str | None = None,
    visibility: str | None = None,
    sensor: str | None = None,
    targets: Path | None = None,
    width: int | None = None,
    height: int | None = None,
    mesh_frame: bool | None = None,
) -> GroundTruth:
    """One object's instances in all images of a split (DATASET/test) or of one scene (DATASET/test/000001).

    Images that do not show the object stay in, without instances: a hypothesis there is false.

    Args:
        object_id: may be left out where the scenes show one object only.
        visibility: in place of scene_gt_info.json, which holds the geometric share; see
            :mod:`evalkit.adapters.visibility`.
        sensor: the camera's or modality's name in sets that have several, such as cam1.
        targets: a test_targets_*.json; images that it does not list are left out, the others are in its order.
        width, height: the images' size where neither images nor camera.json give it.
        mesh_frame: whether poses are those of the mesh that `simgen export bop` made the model from.

    Raises:
        InputError: a file is missing or is not what it should be, or an option is needed.
    """
    scenes = find_scenes(folder, sensor)
    annotations = {scene.number: _annotations(scene) for scene in scenes}
    object_id = _chosen(object_id, annotations, folder)
    dataset = dataset_folder(scenes[0].folder)
    model, remarks = read_object(dataset, object_id, object_name, mesh, units, symmetry)
    rule = None if visibility in (None, "geometric") else Visibility(str(visibility))
    wanted = None if targets is None else read_targets(targets, sensor)
    reader = _Reader(object_id, model, rule, wanted, _SizeSource(dataset, width, height))
    images = [image for scene in scenes for image in reader.images(scene, annotations[scene.number])]
    if not images:
        raise InputError(f"{targets}: it lists no image of {folder} for object {object_id}.")
    if wanted is not None:
        rank = {image_id(*target): i for i, target in enumerate(wanted)}
        images.sort(key=lambda image: rank[image.id])
    if rule is not None:
        remarks.append(rule.remark)
    share = "geometric" if rule is None else rule.share
    truth = GroundTruth(model, images, source=str(folder), remarks=tuple(remarks), share=share)
    return truth_in_mesh_frame(truth, read_origin(models_info(dataset, object_id), object_id)) if mesh_frame else truth


def depth_images(folder: Path, *, sensor: str | None = None, targets: Path | None = None) -> Iterator[DepthImage]:
    """The depth images of a split or of one scene; splits whose ground truth is not public have them too.

    Raises:
        InputError: a file is missing or is not what it should be.
    """
    wanted = None if targets is None else read_targets(targets, sensor)
    for scene in find_scenes(folder, sensor, "scene_camera"):
        cameras = scene.entries("scene_camera")
        for number in cameras:
            if wanted is None or (scene.number, number) in wanted:
                where = f"{scene.file('scene_camera')}: image '{number}'"
                camera = _camera(cameras, number, where, _SizeSource(None, None, None).of(scene, number))
                read = partial(scene.read_depth, number, _depth_scale(cameras[number], where))
                yield DepthImage(image_id(scene.number, number), camera, read)


def _annotations(scene: Scene) -> dict[int, list[dict[str, Any]]]:
    path, entries = scene.file("scene_gt"), scene.entries("scene_gt")
    for number, rows in entries.items():
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise InputError(f"{path}: image '{number}': expected a list of objects with cam_R_m2c, cam_t_m2c, obj_id.")
        for i, row in enumerate(rows):
            if isinstance(row.get("obj_id"), bool) or not isinstance(row.get("obj_id"), int):
                raise InputError(f"{path}: image '{number}': instance {i}: the field 'obj_id' must be a whole number.")
    return entries


def _chosen(object_id: int | None, annotations: dict[int, dict[int, list[dict[str, Any]]]], folder: Path) -> int:
    known = sorted({row["obj_id"] for images in annotations.values() for rows in images.values() for row in rows})
    if object_id is None and len(known) == 1:
        return int(known[0])
    if object_id is not None and object_id in known:
        return object_id
    listed = ", ".join(map(str, known)) or "none"
    wish = "several objects are annotated" if object_id is None else f"object {object_id} is not annotated"
    raise InputError(f"{folder}: {wish}; give --object-id with one of {listed}.")


@dataclass(frozen=True)
class _SizeSource:
    """Where an image's width and height come from: the options, the image, the dataset's camera.json."""

    dataset: Path | None
    width: int | None
    height: int | None

    def of(self, scene: Scene, number: int) -> tuple[int, int]:
        if self.width is not None and self.height is not None:
            return self.width, self.height
        picture = scene.image(number)
        if picture is not None:
            return image_size(picture)
        path = None if self.dataset is None else self.dataset / f"camera{scene.sensor}.json"
        if path is None or not path.is_file():
            raise InputError(f"{scene.folder}: the images' size is not known; give --width and --height.")
        document = load_json(path)
        return int(numbers(document, "width", (), str(path))), int(numbers(document, "height", (), str(path)))


@dataclass(frozen=True)
class _Reader:
    """What is read of every scene: one object's instances, in the images that are wanted."""

    object_id: int
    model: ObjectModel
    rule: Visibility | None
    targets: Targets | None
    size: _SizeSource

    def images(self, scene: Scene, annotations: dict[int, list[dict[str, Any]]]) -> list[GroundTruthImage]:
        cameras = scene.entries("scene_camera")
        infos = _infos(scene) if self.rule is None else {}
        return [
            self._image(scene, number, rows, cameras, infos)
            for number, rows in annotations.items()
            if self._is_target(scene.number, number)
        ]

    def _is_target(self, scene: int, image: int) -> bool:
        if self.targets is None:
            return True
        objects = self.targets.get((scene, image), set())
        return objects is None or self.object_id in objects

    def _image(
        self, scene: Scene, number: int, rows: list[dict[str, Any]], cameras: dict[int, Any], infos: dict[int, Any]
    ) -> GroundTruthImage:
        name = image_id(scene.number, number)
        chosen = [i for i, row in enumerate(rows) if row["obj_id"] == self.object_id]
        cam_from_obj = _poses(rows, chosen, self.model, f"{scene.file('scene_gt')}: image '{number}'")
        where = f"{scene.file('scene_camera')}: image '{number}'"
        camera = _camera(cameras, number, where, self.size.of(scene, number))
        if self.rule is None:
            seen = _visible(infos, number, rows, chosen, f"{scene.file('scene_gt_info')}: image '{number}'")
            return GroundTruthImage(name, camera, cam_from_obj, seen)
        depth = partial(_depth, scene, number, cameras[number], where)
        return GroundTruthImage(
            name, camera, cam_from_obj, *self.rule.of(name, self.model, camera, cam_from_obj, depth)
        )


def _depth(scene: Scene, number: int, entry: Any, where: str) -> Array:
    return scene.read_depth(number, _depth_scale(entry, where))


def _depth_scale(entry: Any, where: str) -> float:
    """Millimeters a step of a depth image."""
    scale = float(numbers(entry, "depth_scale", (), where))
    if scale <= 0:
        raise InputError(f"{where}: the field 'depth_scale' is {scale:g}, and must be positive millimeters a step.")
    return scale


def _poses(rows: list[dict[str, Any]], chosen: list[int], model: ObjectModel, where: str) -> Array:
    def place(i: int) -> str:
        return f"{where}: instance {chosen[i]}"

    rotation = [numbers(rows[k], "cam_R_m2c", (3, 3), f"{where}: instance {k}") for k in chosen]
    translation = [numbers(rows[k], "cam_t_m2c", (3,), f"{where}: instance {k}") * METERS for k in chosen]
    cam_from_obj = checked_poses(np.array(rotation), np.array(translation), place)
    nearest = max(NEAREST, NEAREST_SHARE * model.diameter)
    if (np.linalg.norm(model.centers(cam_from_obj), axis=1) < nearest).any():
        raise InputError(
            f"{where}: an object lies within {1e3 * nearest:.3g} mm of the camera; BOP's unit is millimeters."
        )
    return cam_from_obj


def _camera(cameras: dict[int, Any], number: int, where: str, size: tuple[int, int]) -> Camera:
    if number not in cameras:
        raise InputError(f"{where}: the image is missing, though scene_gt has it.")
    matrix = numbers(cameras[number], "cam_K", (3, 3), where)
    if abs(matrix[0, 1]) > 1e-3 * abs(matrix[0, 0]):
        raise InputError(f"{where}: the field 'cam_K' has skew, which this camera model lacks; rectify the images.")
    if np.abs([matrix[1, 0], matrix[2, 0], matrix[2, 1], matrix[2, 2] - 1]).max() > 1e-6 * max(1.0, abs(matrix[0, 0])):
        raise InputError(f"{where}: the field 'cam_K' is no camera matrix (fx, 0, cx, 0, fy, cy, 0, 0, 1), row by row.")
    try:
        return Camera(*size, *(float(matrix[k]) for k in ((0, 0), (1, 1), (0, 2), (1, 2))))
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _infos(scene: Scene) -> dict[int, Any]:
    path = scene.file("scene_gt_info")
    if not path.is_file():
        raise InputError(f"{path}: is missing, and with it the visible fractions; give {SYNTAX}.")
    return scene.entries("scene_gt_info")


def _visible(infos: dict[int, Any], number: int, rows: list[Any], chosen: list[int], where: str) -> Array:
    entry = infos.get(number)
    if not isinstance(entry, list) or len(entry) != len(rows):
        raise InputError(f"{where}: it must list the {len(rows)} instances that scene_gt lists.")
    seen = np.array([float(numbers(entry[k], "visib_fract", (), f"{where}: instance {k}")) for k in chosen])
    if ((seen < -1e-6) | (seen > 1 + 1e-6)).any():
        raise InputError(f"{where}: every 'visib_fract' must lie between 0 and 1.")
    return np.clip(seen, 0.0, 1.0)
