"""The Siléane dataset's files (Brégier et al. 2017), as its evaluation toolbox reads them.

``poseutils.json`` describes the object, ``gt/SCENE.json`` lists ``{"R", "t", "occlusion_rate"}`` and
``results/SCENE.json`` lists ``{"R", "t", "score"}``. Their poses are world_from_obj in meters; with
``camera_params.txt`` at hand they become cam_from_obj, without they stay and the document says so.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.depth_images import DepthImage, between_clip_planes, read_raw_depth
from evalkit.adapters.fields import numbers
from evalkit.adapters.visibility import require_share
from evalkit.atomic import write_json
from evalkit.datasets.documents import GroundTruth, GroundTruthImage, PredictionImage, Predictions
from evalkit.datasets.pose_rows import parse_rows, row_dicts
from evalkit.datasets.scene import Share
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.json_file import load_json
from evalkit.meshes.read import read_mesh
from evalkit.objects.model import SAMPLE_POINTS, THRESHOLD_RATIO, ObjectModel, sample_surface
from evalkit.objects.symmetry import Symmetry

Array = NDArray[np.float64]
CAMERA_FILE = "camera_params.txt"


def read_ground_truth(
    folder: Path,
    object_name: str | None = None,
    camera_params: Path | None = None,
    visibility: Share | None = None,
) -> GroundTruth:
    """Read FOLDER/poseutils.json and FOLDER/gt/*.json; visibility is 1 - occlusion_rate, which is the returned share.

    The format names no object, so the document has a name only where `object_name` gives one.

    Raises:
        InputError: a file is missing or is not what it should be, or `visibility` asks for the other share.
    """
    require_share(visibility, "returned", "Siléane's occlusion_rate")
    model = read_object(folder, object_name)
    view = _view(folder, camera_params)
    camera, cam_from_world = (None, np.eye(4)) if view is None else view
    images = []
    for path in _scene_files(folder / "gt"):
        world_from_obj, occlusion = parse_rows(load_json(path), "occlusion_rate", str(path))
        images.append(
            GroundTruthImage(path.stem, camera, poses.compose(cam_from_world, world_from_obj), 1.0 - occlusion)
        )
    return GroundTruth(model, images, _frame(view), str(folder), share="returned")


def depth_images(folder: Path) -> Iterator[DepthImage]:
    """The depth images FOLDER/depth/*.PNG, between the clipping planes of camera_params.txt.

    Raises:
        InputError: the camera or its clipping planes are missing, or there are no images.
    """
    return clipped_images(folder / "depth", folder / CAMERA_FILE)


def clipped_images(images: Path, parameters: Path) -> Iterator[DepthImage]:
    """The depth images IMAGES/*.PNG, whose values run between the clipping planes that `parameters` states.

    Raises:
        InputError: the camera or its clipping planes are missing, or there are no images.
    """
    camera, _ = read_camera_params(parameters)
    near, far = _clip_planes(parameters)
    paths = sorted(path for path in images.glob("*") if path.suffix.lower() == ".png")
    if not paths:
        raise InputError(f"{images}: the folder holds no depth images (*.PNG); check the path.")
    for path in paths:
        yield DepthImage(path.stem, camera, partial(_depth, path, near, far))


def _depth(path: Path, near: float, far: float) -> Array:
    raw = read_raw_depth(path)
    if raw.dtype != np.uint16:
        raise InputError(f"{path}: holds {raw.dtype} values, and a Siléane depth image is a 16-bit PNG.")
    return between_clip_planes(raw, near, far)


def read_predictions(folder: Path, object_name: str | None = None, camera_params: Path | None = None) -> Predictions:
    """Read the result files FOLDER/*.json; as the ground truth, they name no object.

    Raises:
        InputError: there is no result file, or one is not what it should be.
    """
    view = _view(_named(folder).parent, camera_params)
    cam_from_world = np.eye(4) if view is None else view[1]
    images = []
    for path in _scene_files(folder):
        world_from_obj, score = parse_rows(load_json(path), "score", str(path))
        images.append(PredictionImage(path.stem, poses.compose(cam_from_world, world_from_obj), score))
    return Predictions(object_name or "", images, _frame(view), str(folder))


def write_predictions(folder: Path, predictions: Predictions, camera_params: Path | None = None) -> str | None:
    """Write result files FOLDER/IMAGE.json, as the toolbox reads them, and say which frame their poses are in.

    Args:
        camera_params: takes poses from the camera's frame to the world's, which the toolbox's ground truth is in.

    Raises:
        InputError: an image's id is no file name.
    """
    world_from_cam, remark = np.eye(4), None
    if predictions.frame == "camera" and camera_params is None:
        remark = (
            "No --camera-params: the poses stay in the camera's frame, but Siléane's ground truth is in the world's."
        )
    elif predictions.frame == "camera" and camera_params is not None:
        world_from_cam = poses.invert(read_camera_params(camera_params)[1])
    for image in predictions.images:
        if Path(image.id).name != image.id:
            raise InputError(f"{predictions.source}: image '{image.id}': the id cannot name a file; rename the image.")
        write_json(folder / f"{image.id}.json", row_dicts(world_from_cam @ image.cam_from_obj, score=image.score))
    return remark


def read_object(folder: Path, name: str | None = None) -> ObjectModel:
    """Read FOLDER/poseutils.json, and the surface from mesh.obj where that lies beside it.

    Raises:
        InputError: a field is missing or wrong, or the type of symmetry is not known.
    """
    path = folder / "poseutils.json"
    document = load_json(path)
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected an object with 'type', 'Rref2i', 'tref2i', 'distance_threshold'.")
    threshold = float(numbers(document, "distance_threshold", (), str(path)))
    if threshold <= 0:
        raise InputError(f"{path}: the field 'distance_threshold' must be positive meters.")
    turn, shift = numbers(document, "Rref2i", (3, 3), str(path)), numbers(document, "tref2i", (3,), str(path))
    if not poses.is_rotation(turn, 5e-3):
        raise InputError(f"{path}: the field 'Rref2i' is not a rotation.")
    inertial_from_obj = poses.from_rotation_translation(poses.nearest_rotation(turn), shift)
    symmetry = _symmetry(path, document).rotated(inertial_from_obj[:3, :3].T)
    model = ObjectModel(
        name=name or "",
        diameter=threshold / THRESHOLD_RATIO,
        centroid=poses.invert(inertial_from_obj)[:3, 3],
        inertial_from_obj=inertial_from_obj,
        lam=_lambda(path, document, symmetry),
        symmetry=symmetry,
        threshold=threshold,
        notes={"source": "Siléane poseutils.json"},
    )
    mesh = folder / "mesh.obj"
    return _with_surface(model, mesh) if mesh.is_file() else model


def read_camera_params(path: Path) -> tuple[Camera, Array]:
    """Read camera_params.txt: the camera and cam_from_world (4, 4).

    Raises:
        InputError: a field is missing or not a number.
    """
    read = _camera_fields(path)
    quaternion_wxyz = read("rotation", 4)
    if abs(np.linalg.norm(quaternion_wxyz) - 1.0) > 1e-2:
        raise InputError(f"{path}: the line 'rotation' must be a unit quaternion w x y z.")
    world_from_cam = poses.from_rotation_translation(
        poses.from_quaternion_xyzw(np.roll(quaternion_wxyz, -1)), read("location", 3)
    )
    width, height, fx, fy, cx, cy = (float(read(key, 1)[0]) for key in ("width", "height", "fu", "fv", "cu", "cv"))
    return Camera(int(width), int(height), fx, fy, cx, cy), poses.invert(world_from_cam)


def _clip_planes(path: Path) -> tuple[float, float]:
    read = _camera_fields(path)
    near, far = float(read("clip_start", 1)[0]), float(read("clip_end", 1)[0])
    if not 0 <= near < far:
        raise InputError(f"{path}: 'clip_start' {near:g} and 'clip_end' {far:g} must be meters, the first the smaller.")
    return near, far


def _camera_fields(path: Path) -> Callable[[str, int], Array]:
    """A function that gives the numbers of a line by its key and their count."""
    lines = (line.split() for line in path.read_text(encoding="utf-8", errors="replace").splitlines())
    fields = {words[0]: words[1:] for words in lines if words}

    def read(key: str, count: int) -> Array:
        try:
            values = np.array([float(word) for word in fields[key]])
        except (KeyError, ValueError):
            values = np.zeros(0)
        if values.shape != (count,) or not np.isfinite(values).all():
            raise InputError(f"{path}: the line '{key}' must hold {count} finite number(s).")
        return values

    return read


def _symmetry(path: Path, document: dict[str, Any]) -> Symmetry:
    """The proper symmetry group, in the inertial frame, where a revolution's axis is z."""
    kind = str(document.get("type", ""))
    lowered = kind.lower()
    if "spher" in lowered:
        return Symmetry.parse("sphere")
    if "revolution" in lowered:
        return Symmetry.parse("revolution-flip" if _has_flip(path, document) else "revolution")
    if "affine" in lowered or "G" in document:
        elements = numbers(document, "G", (-1, 3, 3), str(path))
        try:
            return Symmetry.from_rotations(elements)
        except InputError as error:
            raise InputError(f"{path}: the field 'G': {error}") from None
    raise InputError(f"{path}: the type '{kind[:40]}' is not known; it must be affine, revolution or spherical.")


def _has_flip(path: Path, document: dict[str, Any]) -> bool:
    for key, value in document.items():
        if isinstance(value, bool) and any(word in key.lower() for word in ("flip", "rotoreflection")):
            return value
    raise InputError(f'{path}: a revolution must say whether the flip is a symmetry; add "isFlip": true or false.')


def _lambda(path: Path, document: dict[str, Any], symmetry: Symmetry) -> Array:
    """Lambda (3, 3) in the inertial frame; of a revolution's one number, a matrix that has that `revolution_scale`."""
    if symmetry.kind == "sphere":
        return np.eye(3)  # takes no part in the distance
    scalar = document.get("lambda", document.get("Lambda"))
    if symmetry.kind == "revolution" and isinstance(scalar, int | float):
        return float(numbers({"lambda": scalar}, "lambda", (), str(path))) / np.sqrt(2.0) * np.eye(3)
    return numbers(document, "Lambda", (3, 3), str(path))


def _with_surface(model: ObjectModel, mesh: Path) -> ObjectModel:
    vertices, faces = read_mesh(mesh)
    points = sample_surface(vertices, faces, SAMPLE_POINTS)
    return replace(model, vertices=vertices, faces=faces.astype(np.int32), points=points)


def _named(folder: Path) -> Path:
    """The folder as the user names it, links not followed, but with a name and a parent even where it is "."."""
    return Path(os.path.abspath(folder))


def _view(folder: Path, camera_params: Path | None) -> tuple[Camera, Array] | None:
    path = camera_params or folder / CAMERA_FILE
    return read_camera_params(path) if camera_params is not None or path.is_file() else None


def _frame(view: tuple[Camera, Array] | None) -> str:
    return "world" if view is None else "camera"


def _scene_files(folder: Path) -> list[Path]:
    found = sorted(folder.glob("*.json"))
    if not found:
        raise InputError(f"{folder}: the folder holds no scene files (*.json); check the path.")
    return found
