"""The camera matrix that a file's fields give: one of three rows, a projection matrix, or single numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry.camera_fields import Fields, number, numbers

NEGLIGIBLE = 1e-9  # distortion coefficients and skew per focal length that are written out as good as zero
PLACES = {"fx": (0, 0), "fy": (1, 1), "cx": (0, 2), "cy": (1, 2), "skew": (0, 1)}  # in the camera matrix
SAME_PIXELS = 1e-3  # by which K and P differ when they are the same camera


def camera_matrix(fields: Fields, where: str, rectified: bool) -> tuple[NDArray[np.float64], str]:
    """The intrinsics (3, 3) that the images follow, skew included, and the name of the field that they came from."""
    names = [name for name in ("matrix", "projection") if name in fields]
    known = {name: matrix_field(fields, name, where) for name in names}
    single = {name: number(fields, name, where) for name in PLACES if name in fields}
    if "matrix" in known:
        _compare(known["matrix"], single, where)
    elif set(single) - {"skew"}:
        known["matrix"] = np.eye(3)
        for name in PLACES:
            if name != "skew" or name in single:
                known["matrix"][PLACES[name]] = number(fields, name, where)
    if "projection" in known and (rectified or "matrix" not in known):
        return known["projection"], "projection"
    return known["matrix"], "matrix"


def _compare(matrix: NDArray[np.float64], single: dict[str, float], where: str) -> None:
    """Hold single numbers against a camera matrix (3, 3), which takes the skew from them where it has none.

    Raises:
        InputError: they contradict it.
    """
    for name, value in single.items():
        if name == "skew" and matrix[PLACES[name]] == 0:
            matrix[PLACES[name]] = value
        elif abs(matrix[PLACES[name]] - value) > SAME_PIXELS:
            raise InputError(
                f"{where}: '{name}' is {value:g}, but {matrix[PLACES[name]]:g} in the camera matrix; keep the one that "
                "is right."
            )


def matrix_field(fields: Fields, name: str, where: str) -> NDArray[np.float64]:
    columns, key = (4, "P") if name == "projection" else (3, "K")
    values = numbers(fields[name], where, key)
    if len(values) not in (3 * columns, 16):
        raise InputError(f"{where}: '{key}' must hold {3 * columns} numbers, row by row, as camera_info has it.")
    matrix = _upright(values)
    if matrix[0, 0] == 0 and matrix[1, 1] == 0:
        raise InputError(
            f"{where}: '{key}' is all zeros, as of a camera that was never calibrated; calibrate it first."
        )
    zeros = np.abs([matrix[1, 0], matrix[2, 0], matrix[2, 1], matrix[2, 2] - 1]).max()
    if not zeros <= NEGLIGIBLE * max(1.0, abs(matrix[0, 0])):
        raise InputError(f"{where}: '{key}' must be fx skew cx, 0 fy cy, 0 0 1, row by row; write it so.")
    return matrix[:3, :3].copy()


def is_by_columns(fields: Fields, name: str) -> bool:
    """Whether a field's matrix is written by columns, as MATLAB, Open3D, ARKit and Ensenso write it."""
    try:
        return _turned(numbers(fields[name], "", ""))
    except (InputError, KeyError):
        return False


def _upright(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """A camera matrix (3, 3) or more, read by columns where its zeros say so."""
    side = 4 if len(values) == 16 else 3
    matrix = values.reshape(side, -1)
    return matrix.T if _turned(values) else matrix


def _turned(values: NDArray[np.float64]) -> bool:
    """Whether the principal point stands in the third row and its places in the third column are empty."""
    if len(values) not in (9, 16):
        return False
    matrix = values.reshape(3, 3) if len(values) == 9 else values.reshape(4, 4)
    return bool((matrix[:2, 2] == 0).all() and (matrix[2, :2] != 0).any() and matrix[2, 2] == 1)
