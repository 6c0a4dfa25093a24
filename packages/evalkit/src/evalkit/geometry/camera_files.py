"""Cameras as other people's files describe them: ROS camera_info, BOP camera.json, and our own JSON."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from evalkit.errors import InputError

SUFFIXES_OF_YAML = (".yaml", ".yml")
FORMATS = "give width, height, fx, fy, cx, cy as JSON, a BOP camera.json, or a ROS camera_info as YAML"
LARGEST_FILE = 1 << 20  # bytes; such files hold a few hundred
FISHEYES = ("equidistant", "fisheye", "kannala", "omni", "mei", "unified", "ftheta", "f-theta")
NEGLIGIBLE = 1e-9  # distortion coefficients and skew per focal length that are written out as good as zero


def read_intrinsics(path: Path) -> Any:
    """The document ``{"width", "height", "fx", "fy", "cx", "cy"}`` that is in a camera file, not yet checked.

    BOP's camera.json has these very fields. Of a ROS camera_info, as its calibrator saves it (image_width,
    image_height, camera_matrix) or as a topic prints it (width, height, K or k), it is the camera matrix; the
    projection matrix P is taken where there is none. Lens distortion is not modelled; that there is some is said on
    stderr.

    Raises:
        InputError: the file is neither JSON nor YAML, holds no camera, or not that of a pinhole camera.
    """
    document = _parse(path)
    if not isinstance(document, dict):
        raise InputError(f"{path}: holds no camera; {FORMATS}.")
    _refuse_fisheye(document, str(path))
    if not {"fx", "fy", "cx", "cy"}.isdisjoint(document):
        return document
    matrix = _camera_matrix(document, str(path))
    if matrix is None:
        raise InputError(f"{path}: holds no camera; {FORMATS}.")
    if _is_distorted(document, str(path)):
        print(
            f"Warning: {path}: its lens distortion is ignored, for cameras are pinholes here; "
            "rectify the depth images to its camera matrix first.",
            file=sys.stderr,
        )
    sides = {side: document.get(f"image_{side}", document.get(side)) for side in ("width", "height")}
    for side, value in sides.items():
        if value is None:
            raise InputError(f"{path}: holds a camera matrix but no image_{side}; add it, in pixels.")
    (fx, _, cx), (_, fy, cy) = matrix[0], matrix[1]
    return sides | {"fx": float(fx), "fy": float(fy), "cx": float(cx), "cy": float(cy)}


def _parse(path: Path) -> Any:
    with open(path, "rb") as file:
        raw = file.read(LARGEST_FILE + 1)
    if len(raw) > LARGEST_FILE:
        raise InputError(f"{path}: too large for a camera file; {FORMATS}.")
    is_yaml = path.suffix.lower() in SUFFIXES_OF_YAML
    try:
        text = raw.decode("utf-8")
        return _first_of_yaml(text) if is_yaml else json.loads(text)
    except yaml.MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f" in line {error.problem_mark.line + 1}"
        raise InputError(f"{path}: not a YAML file ({error.problem or error.context}{line}); {FORMATS}.") from None
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{path}: not a {'YAML' if is_yaml else 'JSON'} file ({reason}); {FORMATS}.") from None


def _first_of_yaml(text: str) -> Any:
    """The first document that is not empty: a topic that is printed ends each message with ``---``."""
    return next((document for document in yaml.safe_load_all(text) if document is not None), None)


def _camera_matrix(document: dict[Any, Any], where: str) -> NDArray[np.float64] | None:
    """The upper left (3, 3) of the first matrix that a camera_info has; None where it has none."""
    for key, columns in (("camera_matrix", 3), ("K", 3), ("k", 3), ("projection_matrix", 4), ("P", 4), ("p", 4)):
        if key in document:
            matrix = _numbers(document[key], where, key)
            if len(matrix) != 3 * columns:
                raise InputError(
                    f"{where}: '{key}' must hold {3 * columns} numbers, row by row, as camera_info has it."
                )
            return _pinhole(matrix.reshape(3, columns)[:, :3], where, key)
    return None


def _pinhole(matrix: NDArray[np.float64], where: str, key: str) -> NDArray[np.float64]:
    if matrix[0, 0] == 0 and matrix[1, 1] == 0:
        raise InputError(
            f"{where}: '{key}' is all zeros, as of a camera that was never calibrated; calibrate it first."
        )
    zeros = np.abs([matrix[0, 1], matrix[1, 0], matrix[2, 0], matrix[2, 1], matrix[2, 2] - 1]).max()
    if not zeros <= NEGLIGIBLE * max(1.0, abs(matrix[0, 0])):
        raise InputError(f"{where}: '{key}' must be fx 0 cx, 0 fy cy, 0 0 1, row by row; skew is not modelled.")
    return matrix


def _refuse_fisheye(document: dict[Any, Any], where: str) -> None:
    """A fisheye's matrix is not a pinhole's, not even where all its coefficients are zero."""
    model = document.get("distortion_model")
    if isinstance(model, str) and any(name in model.lower() for name in FISHEYES):
        raise InputError(
            f"{where}: its distortion_model is '{model}', of a fisheye lens, but cameras are pinholes here; rectify "
            "the depth images, and give the pinhole camera that they were rectified to."
        )


def _is_distorted(document: dict[Any, Any], where: str) -> bool:
    for key in ("distortion_coefficients", "D", "d"):
        if document.get(key) is not None:
            return bool((np.abs(_numbers(document[key], where, key)) > NEGLIGIBLE).any())
    return False


def _numbers(value: Any, where: str, key: str) -> NDArray[np.float64]:
    """A list of finite numbers, or ``{"data": [...]}`` as the calibrator writes matrices."""
    values = value.get("data") if isinstance(value, dict) else value
    if not isinstance(values, list) or not all(
        isinstance(number, int | float) and not isinstance(number, bool) and abs(number) < 1e12 for number in values
    ):
        raise InputError(f"{where}: '{key}' must be a list of finite numbers, or have one as its 'data'.")
    return np.array(values, float)
