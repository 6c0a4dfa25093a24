"""Fields that stand for several, the size of a camera's images, and whether the intrinsics can be theirs."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry.camera import MAX_SIDE
from evalkit.geometry.camera_fields import Fields, add_field, number

SIZES = {"width", "height", "roi", "binningx", "binningy"}  # fields that say a size, or need one to mean anything
FARTHEST_OFF = 0.25  # of the image's sides, from its middle to the principal point, that nobody's camera exceeds
SWAPPED_OFF = 0.08  # where a size fits its principal point worse than this, height and width may have changed places
FOCAL_LENGTHS = (0.2, 100.0)  # of the image's longer side: fields of view of 136 and 0.6 degrees
MOST_UNEQUAL = 1.3  # ratio of both focal lengths, of pixels that are no squares
# COLMAP's parameters by camera model, in the order in which cameras.txt has them
COLMAP = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"), "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"), "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}  # fmt: skip
PAIRS = (("f", ("fx", "fy")), ("size", ("width", "height")), ("center", ("cx", "cy")))
LISTS = {"radial": ("k1", "k2", "k3"), "tangential": ("p1", "p2")}  # MATLAB's
ORIGINS = {"corner": 0.5, "matlab": 1.0}  # where the center of the first pixel lies, by who counts so
Matrix = NDArray[np.float64]
ImageSize = Callable[[], tuple[int, int]]


def expanded(fields: Fields, where: str) -> Fields:
    """Fields in place of those that stand for several: COLMAP's row, one focal length, a size, a principal point.

    Raises:
        InputError: such a field is malformed, or contradicts another.
    """
    if "colmap" in fields:
        fields = _colmap(fields["colmap"], where)
    fields = dict(fields)
    for name, parts in PAIRS:
        if name not in fields:
            continue
        value = _pair(fields.pop(name), name, parts)
        if value is None:
            raise InputError(f"{where}: the field '{name}' must hold two numbers.")
        if name == "size" and fields.get("dialect") == "matlab":
            value = value[::-1]
        for part, found in zip(parts, value, strict=True):
            add_field(fields, part, found, where)
        if name == "size":
            fields["listed"] = True
    for name, names in LISTS.items():
        values = fields.pop(name, None)
        if isinstance(values, list) and len(values) <= len(names):
            for part, found in zip(names, values, strict=False):
                add_field(fields, part, found, where)
        elif values is not None:
            raise InputError(f"{where}: '{name}' distortion must be a list of at most {len(names)} numbers.")
    return fields


def _pair(value: Any, name: str, parts: tuple[str, str]) -> list[Any] | None:
    """Two values from a list, a group or one number; 640x480 of a size."""
    if isinstance(value, dict):
        names = {str(key).lower(): item for key, item in value.items()}
        value = [names.get(part, names.get(axis)) for part, axis in zip(parts, "xy", strict=True)]
    if isinstance(value, str) and (sides := re.fullmatch(r"(\d+)\s*[x*,]\s*(\d+)", value)):
        value = [int(side) for side in sides.groups()]
    if isinstance(value, list):
        value = [n for row in value for n in (row if isinstance(row, list) else [row])]
        return value if len(value) == 2 else None
    return [value, value] if name == "f" else None


def _colmap(row: dict[str, Any], where: str) -> Fields:
    model, values = row["model"], row["values"]
    names = COLMAP.get(model)
    if names is None or len(names) != len(values):
        raise InputError(
            f"{where}: the camera model {model} with {len(values)} parameters is not read; known are "
            f"{', '.join(COLMAP)}; undistort the images, and give the pinhole camera of the result."
        )
    width, height = row["size"]
    return dict(zip(names, values, strict=True)) | {"width": width, "height": height, "dialect": "corner"}


def counted_from_centers(matrix: Matrix, fields: Fields) -> tuple[Matrix, list[str]]:
    """The camera matrix (3, 3) whose pixels count from the center of the first, and a remark where they did not."""
    dialect = fields.get("dialect")
    if dialect is None:
        return matrix, []
    matrix = matrix.copy()
    matrix[:2, 2] -= ORIGINS[dialect]
    if dialect == "matlab":
        return matrix, ["is MATLAB's: pixels count from 1, so that the principal point is moved by one."]
    return matrix, ["counts pixels from the corner of the first, so that the principal point is moved by half a pixel."]


def from_angle(fields: Fields, size: tuple[int, int], where: str) -> Fields:
    """Fields with a focal length where Blender and NeRFs say the horizontal field of view alone, in radians.

    Raises:
        InputError: it is no such angle.
    """
    if "anglex" not in fields or {"fx", "matrix"} & set(fields):
        return fields
    angle = number(fields, "anglex", where)
    if not 0 < angle < math.pi:
        raise InputError(f"{where}: camera_angle_x must be the horizontal field of view in radians, not {angle:g}.")
    focal = size[0] / (2 * math.tan(angle / 2))
    middle = {"cx": size[0] / 2, "cy": size[1] / 2}
    return {"fx": focal, "fy": focal, "dialect": "corner"} | middle | fields


def image_size_of(fields: Fields, image_size: ImageSize | None, where: str) -> tuple[tuple[int, int], bool]:
    """Width and height, and whether they are those of the images because the file has none.

    Raises:
        InputError: nobody says a size.
    """
    if image_size is not None and not SIZES & set(fields):
        return image_size(), True
    sides = []
    for side in ("width", "height"):
        if side not in fields:
            raise InputError(
                f"{where}: holds a camera but no image size; add image_{side}, in pixels, or write width, height, fx, "
                "fy, cx, cy as JSON."
            )
        value = number(fields, side, where)
        if value != int(value):
            raise InputError(f"{where}: '{side}' must be a whole number of pixels.")
        if not 0 < value <= MAX_SIDE:
            raise InputError(f"{where}: '{side}' is {value:g}; it must be 1 to {MAX_SIDE} pixels.")
        sides.append(int(value))
    return (sides[0], sides[1]), False


def require_fitting(matrix: Matrix, size: tuple[int, int], taken: bool, fields: Fields, where: str) -> list[str]:
    """Remarks on a camera matrix (3, 3) that is odd for images of that size.

    Args:
        taken: the size is that of the images, for the file says none.

    Raises:
        InputError: it cannot be theirs.
    """
    width, height = size
    focal = np.diag(matrix)[:2] / max(size)
    if not (FOCAL_LENGTHS[0] <= focal.min() and focal.max() <= FOCAL_LENGTHS[1]):
        raise InputError(
            f"{where}: focal lengths of {matrix[0, 0]:g} and {matrix[1, 1]:g} pixels make no sense for images of "
            f"{width} x {height}; millimeters, or shares of the image, must be turned into pixels."
        )
    off = _off(matrix, size)
    if taken and off > FARTHEST_OFF:
        raise InputError(
            f"{where}: its principal point ({matrix[0, 2]:g}, {matrix[1, 2]:g}) is far from the middle of images of "
            f"{width} x {height} pixels, so it is of another size; give the camera matrix of this one."
        )
    if fields.get("listed") and off > SWAPPED_OFF and 2 * _off(matrix, (height, width)) < off:
        raise InputError(
            f"{where}: its principal point ({matrix[0, 2]:g}, {matrix[1, 2]:g}) fits images of {height} x {width} "
            f"better than its size [{width}, {height}], where height may stand first; write width and height by name."
        )
    unequal = max(focal) > MOST_UNEQUAL * min(focal)
    if unequal and off > FARTHEST_OFF:
        raise InputError(
            f"{where}: focal lengths of {matrix[0, 0]:g} and {matrix[1, 1]:g} pixels and a principal point at "
            f"({matrix[0, 2]:g}, {matrix[1, 2]:g}) make no sense for {width} x {height}; mend their order, fx, fy, cx, "
            "cy."
        )
    remarks = []
    if off > FARTHEST_OFF and "roi" not in fields:
        remarks.append(
            f"its principal point ({matrix[0, 2]:g}, {matrix[1, 2]:g}) is far from the middle of {width} x {height} "
            "pixels; unless the images are a part of larger ones, it is of another size."
        )
    if unequal:
        remarks.append(
            f"its focal lengths differ much, {matrix[0, 0]:g} and {matrix[1, 1]:g} pixels; check their order."
        )
    return remarks


def _off(matrix: Matrix, size: tuple[int, int]) -> float:
    """How far the principal point is from the middle, as the larger share of the image's sides."""
    return float(np.abs((matrix[:2, 2] - (np.array(size) - 1) / 2) / size).max())
