"""BOP's results file, one pose a row: ``scene_id,im_id,obj_id,score,R,t,time``.

R is row-wise and t in millimeters, their numbers separated by spaces; time is the seconds spent on the image, the same
in all its rows, -1 where not known.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evalkit.adapters.bop.mesh_frame import predictions_in_bop_frame, predictions_in_mesh_frame, read_origin
from evalkit.adapters.bop.object import METERS
from evalkit.adapters.fields import checked_poses, csv_rows, image_id
from evalkit.atomic import atomic_path
from evalkit.datasets.documents import PredictionImage, Predictions
from evalkit.errors import InputError

Array = NDArray[np.float64]
COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")
UNKNOWN_TIME = -1.0
CENTERED = 1e-6  # meters
SAME_TIME = 1e-3  # seconds; bop_toolkit asks for the same
IMAGE_ID = re.compile(r"(\d+)-(\d+)")
OBJECT_NAME = re.compile(r"obj_(\d+)")


class _Row(NamedTuple):
    line: int
    scene: int
    image: int
    obj: int
    values: list[float]  # score, R (9), t (3) in millimeters, time


def read_predictions(
    path: Path, *, object_id: int | None = None, object_name: str | None = None, models_info: Path | None = None
) -> Predictions:
    """One object's estimates; `object_id` may be left out where the file has one object only.

    Args:
        models_info: of a set that `simgen export bop` wrote; takes the poses to the frame of its mesh.

    Raises:
        InputError: a row is not what it should be; the sentence names its line.
        OSError: the file cannot be read.
    """
    rows = list(_rows(path))
    known = sorted({row.obj for row in rows})
    if object_id is None and len(known) == 1:
        object_id = known[0]
    if object_id is None or object_id not in known:
        raise InputError(
            f"{path}: give --object-id with one of {', '.join(map(str, known)) or 'none: it has no rows'}."
        )
    rows = [row for row in rows if row.obj == object_id]
    values = np.array([row.values for row in rows])
    places = [row.line for row in rows]
    cam_from_obj = checked_poses(
        values[:, 1:10], values[:, 10:13] * METERS, lambda i: f"{path}: line {places[i]}: the estimate"
    )
    images = _images(path, rows, cam_from_obj, values[:, 0], values[:, 13])
    found = Predictions(object_name or f"obj_{object_id:06d}", images, source=str(path))
    return found if models_info is None else predictions_in_mesh_frame(found, read_origin(models_info, object_id))


def write_predictions(
    path: Path, predictions: Predictions, *, object_id: int | None = None, models_info: Path | None = None
) -> str | None:
    """Write a results file; an image without hypotheses leaves no trace in it. Says in whose frame the poses are.

    Args:
        models_info: of a set that `simgen export bop` wrote; takes the poses from the frame of its mesh to BOP's.

    Raises:
        InputError: an image's id is not two numbers, the object's number is not known, or poses are not the camera's.
    """
    if predictions.frame != "camera":
        raise InputError(f"{predictions.source}: its poses are in the world's frame, but BOP wants the camera's.")
    number = OBJECT_NAME.fullmatch(predictions.object_name)
    if object_id is None and number is None:
        name = f"the object's name, '{predictions.object_name}'," if predictions.object_name else "the object's name"
        raise InputError(f"{predictions.source}: {name} does not tell BOP's number of it; give --object-id.")
    obj = int(number[1]) if object_id is None and number is not None else object_id
    if obj is not None and models_info is not None:
        predictions = predictions_in_bop_frame(predictions, read_origin(models_info, obj))
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        file.write(",".join(COLUMNS) + "\n")
        for image in predictions.images:
            scene, im = _two_numbers(image.id, predictions.source)
            time = UNKNOWN_TIME if image.time_s is None else image.time_s
            for pose, score in zip(image.cam_from_obj, image.score, strict=True):
                rotation, translation = _words(pose[:3, :3]), _words(pose[:3, 3] / METERS)
                file.write(f"{scene},{im},{obj},{float(score)!r},{rotation},{translation},{time!r}\n")
    center = predictions.box_center
    if models_info is not None or center is None or np.linalg.norm(center) <= CENTERED:
        return None
    return (
        f"The mesh's origin is {1e3 * np.linalg.norm(center):.3g} mm from the center of its box, where BOP's models "
        "have it; if these are results on a set by 'simgen export bop', give its models/models_info.json as "
        "--models-info."
    )


def _rows(path: Path) -> Iterator[_Row]:
    lines = csv_rows(path)
    if tuple(next(lines, (0, []))[1]) != COLUMNS:
        raise InputError(f"{path}: the first line must be {','.join(COLUMNS)}.")
    return (_row(path, line, words) for line, words in lines)


def _row(path: Path, line: int, words: list[str]) -> _Row:
    try:
        scene, image, obj = (int(word) for word in words[:3])
        score, rotation, translation, time = words[3:]
        parts = [[score], rotation.split(), translation.split(), [time]]
        values = [float(word) for part in parts for word in part]
    except ValueError:
        values, parts = [], []
    if [len(part) for part in parts] != [1, 9, 3, 1] or not np.isfinite(values).all():
        raise InputError(f"{path}: line {line}: expected {','.join(COLUMNS)} with 9 finite numbers in R and 3 in t.")
    return _Row(line, scene, image, obj, values)


def _images(path: Path, rows: list[_Row], poses: Array, score: Array, time: Array) -> list[PredictionImage]:
    by_image: dict[tuple[int, int], list[int]] = {}
    for i, row in enumerate(rows):
        by_image.setdefault((row.scene, row.image), []).append(i)
    images = []
    for (scene, image), members in sorted(by_image.items()):
        if np.ptp(time[members]) > SAME_TIME:
            raise InputError(f"{path}: line {rows[members[0]].line}: the image's rows must all have the same time.")
        seconds = float(time[members[0]])
        name = image_id(scene, image)
        images.append(PredictionImage(name, poses[members], score[members], seconds if seconds >= 0 else None))
    return images


def _two_numbers(name: str, source: str) -> tuple[int, int]:
    match = IMAGE_ID.fullmatch(name)
    if match is None:
        raise InputError(f"{source}: image '{name}': BOP knows images by two numbers; rename it like 000001-000003.")
    return int(match[1]), int(match[2])


def _words(numbers: Array) -> str:
    return " ".join(repr(float(number)) for number in numbers.ravel())
