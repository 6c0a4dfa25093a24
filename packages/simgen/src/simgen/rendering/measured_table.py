"""A table that somebody measured: where it lies before the camera, a plane or a pose from hand-eye calibration."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.json_file import load_json

Array = NDArray[np.float64]
FARTHEST = 50.0  # meters; what is farther was measured in another unit
ROTATION_TOLERANCE = 1e-3  # calibration files are rounded
SHALLOWEST = 0.05  # cosine between the middle of the image's ray and the table's normal
KNOWN_TURN = 5.0  # degrees to either side: nobody puts a bin down exactly as it stood before
FORMS = (
    'a plane A,B,C,D with A·x + B·y + C·z = D in meters before the camera, or a JSON file with "plane" (four numbers) '
    'or with "cam_from_table" or "table_from_cam" (4 x 4, meters, z up from the table)'
)


def read_table(text: str, camera: Camera) -> tuple[Array, float]:
    """What ``--table`` says.

    Args:
        text: four numbers, or the name of a JSON file.

    Returns:
        cam_from_table (4, 4), rigid: origin where the middle of the bin's floor is, z up; and by how many degrees the
        bin may be turned on the table, 180 where only a plane is known.

    Raises:
        InputError: it is none of the forms, no plane or pose, or the camera does not look at the table from above.
    """
    if text.count(",") == 3 and not Path(text).exists():
        try:
            return _of_plane([float(number) for number in text.split(",")], camera, f"--table {text}"), 180.0
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"--table {text}: give {FORMS}.") from None
    if not Path(text).is_file():
        raise InputError(f"--table {text}: no such file, nor four numbers; give {FORMS}.")
    document = load_json(text)
    forms = {"plane", "cam_from_table", "table_from_cam"}
    if not isinstance(document, dict) or len(document) != 1 or not forms & set(document):
        raise InputError(f"{text}: must hold one entry and nothing else; give {FORMS}.")
    ((name, value),) = document.items()
    if name == "plane":
        return _of_plane(_numbers(value, (4,), text), camera, text), 180.0
    pose = _rigid(_numbers(value, (4, 4), text), text)
    return _facing(poses.invert(pose) if name == "table_from_cam" else pose, camera, text), KNOWN_TURN


def _numbers(value: Any, shape: tuple[int, ...], where: str) -> Array:
    try:
        array = np.array(value, float)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"{where}: expected {' x '.join(map(str, shape))} finite numbers; give {FORMS}.")
    return array


def _rigid(pose: Array, where: str) -> Array:
    rotation = poses.nearest_rotation(pose[:3, :3])
    off = max(float(np.abs(rotation - pose[:3, :3]).max()), float(np.abs(pose[3] - [0, 0, 0, 1]).max()))
    if off > ROTATION_TOLERANCE:
        raise InputError(f"{where}: its 4 x 4 matrix is no rotation and translation; rows are written one by one.")
    return poses.from_rotation_translation(rotation, pose[:3, 3])


def _of_plane(numbers: Array | list[float], camera: Camera, where: str) -> Array:
    """The origin is what the middle of the image sees, x points along the image's rows as far as the plane allows."""
    *normal, offset = (float(number) for number in numbers)
    length = math.hypot(*normal)
    if not (np.isfinite(length) and length > 0 and np.isfinite(offset) and offset != 0):
        raise InputError(f"{where}: no plane before the camera; give {FORMS}.")
    up = -np.sign(offset) * np.array(normal) / length  # toward the camera, which is the origin
    ray = camera.unproject([(camera.width - 1) / 2, (camera.height - 1) / 2], 1.0)
    toward = float((up * ray).sum())
    if toward > -SHALLOWEST:
        raise InputError(f"{where}: the camera does not look at that plane; its z axis points away from the lens.")
    along_rows = np.array([1.0, 0.0, 0.0]) - up[0] * up
    x = along_rows / math.hypot(*along_rows)
    pose = np.column_stack([x, np.cross(up, x), up])
    return _facing(poses.from_rotation_translation(pose, ray * (-abs(offset) / length / toward)), camera, where)


def _facing(cam_from_table: Array, camera: Camera, where: str) -> Array:
    """The pose, if the camera is above the table and shows the bin's middle."""
    x, y, z = cam_from_table[:3, 3]
    if not np.abs(cam_from_table[:3, 3]).max() < FARTHEST:
        raise InputError(f"{where}: the table is {z:g} m away; give meters.")
    if poses.invert(cam_from_table)[2, 3] <= 0:
        raise InputError(f"{where}: the camera is below the table; the table's z axis points up, the camera's forward.")
    u, v = camera.project([x, y, z]) if z > 0 else (-1.0, -1.0)
    if not (0 <= u <= camera.width - 1 and 0 <= v <= camera.height - 1):
        raise InputError(f"{where}: the camera does not show the table's origin, where the middle of the bin would be.")
    return cam_from_table
