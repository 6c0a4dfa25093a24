"""The Fraunhofer IPA Bin-Picking dataset's files (Kleeberger et al. 2019).

``parameter.json`` describes the camera, ``gt/cycle_0000/011.csv`` the instances of one image: id (0 is the bin), class,
x, y, z in meters, the rotation column by column, and last the visibility in the perspective image. The poses are
camera from object with x to the left and y up. The image is a window, ``resolutionX`` by ``resolutionY``, of a square
one of side ``resolution_big`` that spans ``perspectiveAngle`` degrees; the window starts ``pixelOffset_X_KoSyTopLeft``
to the right and ``pixelOffset_Y_KoSyTopLeft`` down. Depth images, ``p_depth/cycle_0000/011_depth_uint16.png``, run
linearly from ``clip_start`` to ``clip_end`` meters. The dataset publishes no format of results; results are read from
files like these with a score in the last column.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.depth_images import DepthImage, between_clip_planes, read_raw_depth
from evalkit.adapters.fields import checked_poses, csv_rows, image_id, numbers
from evalkit.adapters.visibility import require_share
from evalkit.datasets.documents import GroundTruth, GroundTruthImage, PredictionImage, Predictions
from evalkit.datasets.scene import Share
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.json_file import load_json
from evalkit.meshes.load import load_object

Array = NDArray[np.float64]
PARAMETERS = "parameter.json"
DEPTH_SUFFIX = "_depth_uint16.png"
CV_FROM_IPA = np.diag([-1.0, -1.0, 1.0, 1.0])
CYCLE = re.compile(r"cycle_(\d+)")
FIRST_NUMBER, NUMBERS = 2, 12  # columns of x, y, z and the rotation, after id and class
FEWEST_COLUMNS = FIRST_NUMBER + NUMBERS + 1
LEVELS_UP = 3  # from gt/cycle_0000 to the folder of parameter.json


class _Table(NamedTuple):
    """A CSV's instances."""

    cam_from_obj: Array  # (n, 4, 4)
    last: Array  # (n,) visibility or score


def read_ground_truth(
    folder: Path,
    *,
    object_name: str | None = None,
    mesh: Path | None = None,
    units: str | None = None,
    symmetry: str | None = None,
    camera: Path | None = None,
    visibility: Share | None = None,
) -> GroundTruth:
    """All images of an object's folder (with parameter.json and gt/), or of one folder within its gt/.

    Args:
        mesh, units, symmetry: see :func:`evalkit.meshes.load.load_object`.
        camera: our JSON, in place of parameter.json.
        visibility: the files hold the geometric share alone.

    Raises:
        InputError: a file is missing or is not what it should be, or an option is needed or cannot be met.
    """
    require_share(visibility, "geometric", "IPA's visibility")
    files = _find(folder)
    if mesh is None:
        raise InputError(f"{folder}: IPA's ground truth carries no model; give --mesh and --units.")
    view = read_camera(_parameter_file(folder)) if camera is None else Camera.load(camera)
    model = replace(load_object(mesh, units, symmetry), name=object_name or "")  # the format names no object
    images = []
    for name, path in files.items():
        cam_from_obj, seen = _read_table(path)
        if ((seen < -1e-6) | (seen > 1 + 1e-6)).any():
            raise InputError(f"{path}: the last column, the visibility, must lie between 0 and 1.")
        images.append(GroundTruthImage(name, view, cam_from_obj, np.clip(seen, 0.0, 1.0)))
    return GroundTruth(model, images, source=str(folder), share="geometric")


def read_predictions(folder: Path, *, object_name: str | None = None) -> Predictions:
    """Results in files named and laid out as the ground truth's, with a score in the last column.

    Raises:
        InputError: a file is not what it should be.
    """
    images = [PredictionImage(name, *_read_table(path)) for name, path in _find(folder).items()]
    return Predictions(object_name or "", images, source=str(folder))


def depth_images(folder: Path) -> Iterator[DepthImage]:
    """The depth images, in the perspective view, of an object's folder or of a folder within its p_depth/.

    Raises:
        InputError: there is none, or parameter.json does not say what their values mean.
    """
    path = _parameter_file(folder)
    camera, document = read_camera(path), load_json(path)
    near, far = (float(numbers(document, key, (), str(path))) for key in ("clip_start", "clip_end"))
    if not 0 <= near < far:
        raise InputError(f"{path}: the fields 'clip_start' and 'clip_end' must be meters, the first the smaller.")
    root = folder / "p_depth" if (folder / "p_depth").is_dir() else folder
    files = sorted(root.rglob(f"*{DEPTH_SUFFIX}"))
    if not files:
        raise InputError(f"{folder}: holds no p_depth/cycle_0000/000{DEPTH_SUFFIX}; give the folder of one object.")
    for file in files:
        name = _image_name(file.with_name(file.name.removesuffix(DEPTH_SUFFIX)), root)
        yield DepthImage(name, camera, partial(_read_depth, file, near, far))


def _read_depth(path: Path, near: float, far: float) -> Array:
    return between_clip_planes(read_raw_depth(path), near, far)


def read_camera(path: Path) -> Camera:
    """The camera that parameter.json describes, integer pixel = pixel center.

    Raises:
        InputError: a field is missing or makes no sense.
    """
    document = load_json(path)

    def read(key: str) -> float:
        return float(numbers(document, key, (), str(path)))

    angle, side = math.radians(read("perspectiveAngle")), read("resolution_big")
    if not 0 < angle < math.pi:
        raise InputError(f"{path}: the field 'perspectiveAngle' must lie between 0 and 180 degrees.")
    focal = side / 2 / math.tan(angle / 2)
    center = side / 2 - 0.5
    try:
        return Camera(
            width=int(read("resolutionX")),
            height=int(read("resolutionY")),
            fx=focal,
            fy=focal,
            cx=center - read("pixelOffset_X_KoSyTopLeft"),
            cy=center - read("pixelOffset_Y_KoSyTopLeft"),
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _parameter_file(folder: Path) -> Path:
    folders = [folder, *list(folder.resolve().parents)[:LEVELS_UP]]
    found = next((candidate / PARAMETERS for candidate in folders if (candidate / PARAMETERS).is_file()), None)
    if found is None:
        raise InputError(f"{folder}: there is no {PARAMETERS} here or above; give --camera camera.json.")
    return found


def _find(folder: Path) -> dict[str, Path]:
    """The CSV files by image id; cycle_0003/011.csv is 000003-000011, any other is known by its path."""
    root = folder / "gt" if (folder / "gt").is_dir() else folder
    files = {_image_name(path, root): path for path in sorted(root.rglob("*.csv"))}
    if not files:
        raise InputError(f"{folder}: holds no gt/cycle_0000/000.csv; give the folder of one object.")
    return files


def _image_name(path: Path, root: Path) -> str:
    cycle = CYCLE.fullmatch(path.resolve().parent.name)
    if cycle and path.stem.isdecimal():
        return image_id(int(cycle[1]), int(path.stem))
    return "-".join(path.relative_to(root).with_suffix("").parts)


def _read_table(path: Path) -> _Table:
    rows, line_numbers = [], []
    lines = csv_rows(path)
    header = next(lines, (0, []))[1]
    if len(header) < FEWEST_COLUMNS or header[0] != "id":
        raise InputError(
            f"{path}: the first line must name the columns: id, class, x, y, z, nine of the rotation, visibility."
        )
    for line, words in lines:
        if (row := _row(path, line, words, len(header))) is not None:
            rows.append(row)
            line_numbers.append(line)
    values = np.array(rows).reshape(-1, NUMBERS + 1)
    rotation = values[:, 3:12].reshape(-1, 3, 3).swapaxes(1, 2)  # column by column
    in_ipa = checked_poses(rotation, values[:, :3], lambda i: f"{path}: line {line_numbers[i]}: the pose")
    return _Table(CV_FROM_IPA @ in_ipa, values[:, -1])


def _row(path: Path, line: int, words: list[str], columns: int) -> list[float] | None:
    """x, y, z, rotation and the last column; None for the bin."""
    try:
        if int(words[0]) == 0:
            return None
        values = [float(word) for word in [*words[FIRST_NUMBER : FIRST_NUMBER + NUMBERS], words[-1]]]
    except ValueError:
        values = []
    if len(words) != columns or not values or not np.isfinite(values).all():
        raise InputError(f"{path}: line {line}: expected {columns} columns, all but 'class' finite numbers.")
    return values
