"""The ICVL Bin-Picking dataset's files (Doumanoglou et al. 2016, scenario 2).

``test/01`` holds, of image I, ``rgbI.png``, ``depthI.png`` (16 bits, millimeters, 0 = missing), ``camera_pose_I.txt``
and ``coffee_cupK_I.txt`` for each instance K: camera from object, a 4x4 matrix as text, in meters and with OpenGL's
axes (y up, z backwards). The poses are those of the models that come with the dataset. It publishes no visibility and
no format of results; results are read from files of the same names and contents with a score below the matrix.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.depth_images import DepthImage, read_raw_depth
from evalkit.adapters.fields import checked_poses, image_id
from evalkit.adapters.visibility import SYNTAX, Visibility
from evalkit.datasets.documents import GroundTruth, GroundTruthImage, PredictionImage, Predictions
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.meshes.load import load_object

Array = NDArray[np.float64]
CAMERA = Camera(640, 480, 550.0, 540.0, 316.0, 244.0)
CV_FROM_GL = np.diag([1.0, -1.0, -1.0, 1.0])
DEPTH_UNIT = 1e-3
POSE_FILE = re.compile(r"(.*\D)(\d+)_(\d+)\.txt")
CAMERA_FILE = re.compile(r"camera_pose_(\d+)\.txt")
LAST_ROW = [0.0, 0.0, 0.0, 1.0]


class _Image(NamedTuple):
    scene: Path
    number: int
    files: dict[str, list[Path]]  # by object, in the order of the instances

    @property
    def id(self) -> str:
        return image_id(int(self.scene.resolve().name), self.number)


def read_ground_truth(
    folder: Path,
    *,
    object_name: str | None = None,
    mesh: Path | None = None,
    units: str | None = None,
    symmetry: str | None = None,
    visibility: str | None = None,
    camera: Path | None = None,
) -> GroundTruth:
    """One object's instances in all images of ``test`` or of one scene (``test/01``).

    Args:
        object_name: as the files name it; may be left out where there is one object only.
        mesh, units, symmetry: see :func:`evalkit.meshes.load.load_object`.
        visibility: see :mod:`evalkit.adapters.visibility`.
        camera: our JSON, in place of the dataset's 640 x 480, fx 550, fy 540, cx 316, cy 244.

    Raises:
        InputError: a file is missing or is not what it should be, or an option is needed.
    """
    images, name = _find(folder, object_name)
    if mesh is None:
        raise InputError(f"{folder}: ICVL's scenes carry no model; give --mesh and --units (its own are in m).")
    if visibility is None:
        raise InputError(f"{folder}: ICVL does not say how visible an instance is; give {SYNTAX}.")
    model = load_object(mesh, units, symmetry, name)
    view = CAMERA if camera is None else Camera.load(camera)
    rule = Visibility(visibility)
    truths = []
    for image in images:
        cam_from_obj = _poses(image.files.get(name, []))[0]
        shares = rule.of(image.id, model, view, cam_from_obj, partial(_read_depth, image))
        truths.append(GroundTruthImage(image.id, view, cam_from_obj, *shares))
    return GroundTruth(model, truths, source=str(folder), remarks=(rule.remark,), share=rule.share)


def read_predictions(folder: Path, *, object_name: str | None = None) -> Predictions:
    """Results in files named as the ground truth's, each with a score below its matrix.

    Raises:
        InputError: a file is not what it should be, or there are several objects and none was chosen.
    """
    images, name = _find(folder, object_name)
    found = [PredictionImage(image.id, *_poses(image.files.get(name, []), scored=True)) for image in images]
    return Predictions(name, found, source=str(folder))


def depth_images(folder: Path, *, camera: Path | None = None) -> Iterator[DepthImage]:
    """The depth images of ``test`` or of one scene.

    Raises:
        InputError: there is none, or one is not what it should be.
    """
    view = CAMERA if camera is None else Camera.load(camera)
    for scene in _scenes(folder):
        for image in _images(scene):
            yield DepthImage(image.id, view, partial(_read_depth, image))


def _scenes(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the dataset's test, or one of its scenes such as test/01.")
    return [path for path in [folder, *sorted(folder.iterdir())] if path.is_dir() and path.resolve().name.isdecimal()]


def _find(folder: Path, object_name: str | None) -> tuple[list[_Image], str]:
    """The images of all scenes, and the object that is meant."""
    images = [image for scene in _scenes(folder) for image in _images(scene)]
    known = sorted({name for image in images for name in image.files})
    if not known:
        raise InputError(f"{folder}: neither it nor its numbered folders hold poses such as coffee_cup1_0.txt.")
    if object_name is None and len(known) == 1:
        return images, known[0]
    if object_name is None or object_name not in known:
        raise InputError(f"{folder}: give --object with one of {', '.join(known)}.")
    return images, object_name


def _images(scene: Path) -> Iterator[_Image]:
    numbers = {int(match[1]) for path in scene.iterdir() if (match := CAMERA_FILE.fullmatch(path.name))}
    files: dict[int, dict[str, list[tuple[int, Path]]]] = {number: {} for number in numbers}
    for path in scene.iterdir():
        if match := POSE_FILE.fullmatch(path.name):
            name, instance, number = match[1], int(match[2]), int(match[3])
            files.setdefault(number, {}).setdefault(name, []).append((instance, path))
    for number, by_name in sorted(files.items()):
        yield _Image(scene, number, {name: [path for _, path in sorted(rows)] for name, rows in by_name.items()})


def _poses(files: list[Path], scored: bool = False) -> tuple[Array, Array]:
    """The files' poses (n, 4, 4), OpenCV's axes, and scores (n,), 1 where none is read."""
    rows = np.array([_numbers(path, scored) for path in files]).reshape(-1, 17 if scored else 16)
    matrices = CV_FROM_GL @ rows[:, :16].reshape(-1, 4, 4)
    cam_from_obj = checked_poses(matrices[:, :3, :3], matrices[:, :3, 3], lambda i: f"{files[i]}: the pose")
    return cam_from_obj, rows[:, 16] if scored else np.ones(len(rows))


def _numbers(path: Path, scored: bool) -> list[float]:
    try:
        values = [float(word) for word in path.read_text(encoding="utf-8", errors="replace").split()]
    except ValueError:
        values = []
    wanted = 17 if scored else 16
    if len(values) != wanted or values[12:16] != LAST_ROW or not np.isfinite(values).all():
        score = " and a score below it" if scored else ""
        raise InputError(f"{path}: expected a 4x4 matrix of finite numbers with the last row 0 0 0 1{score}.")
    return values


def _read_depth(image: _Image) -> Array:
    return read_raw_depth(image.scene / f"depth{image.number}.png") * DEPTH_UNIT
