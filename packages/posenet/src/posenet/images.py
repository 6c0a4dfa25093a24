"""Depth images from files: what users have on disk, as metres."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError

SUFFIXES = (".png", ".tif", ".tiff", ".npy", ".exr")


def read_depth(path: Path | str, depth_unit: float | None) -> NDArray[np.float32]:
    """A depth image (height, width) in metres from a 16-bit PNG, a TIFF or an NPY file.

    `depth_unit` is the metres that one step of the file's values stands for; integer images need it, floating-point
    ones are metres without it.

    Raises:
        InputError: the file is missing, of another kind, has several channels, or is an integer image without a unit.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such depth image; check the path.")
    values = _load_npy(path) if path.suffix.lower() == ".npy" else cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if values is None:
        raise InputError(f"{path}: not a readable image; give a 16-bit PNG, a TIFF or an NPY file.")
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[:, :, 0]
    if values.ndim != 2 or values.size == 0:
        raise InputError(f"{path}: has the shape {values.shape}, and a depth image has one channel (height, width).")
    if values.dtype == np.uint8:
        raise InputError(f"{path}: an 8-bit image holds no metric depth; save depth as a 16-bit PNG, TIFF or NPY.")
    if values.dtype.kind not in "uif":
        raise InputError(f"{path}: holds values of type {values.dtype}, and depth is a number.")
    if depth_unit is None and values.dtype.kind != "f":
        raise InputError(f"{path}: holds whole numbers; say what one step is in metres, e.g. --depth-unit 0.001.")
    return values.astype(np.float32) * np.float32(1.0 if depth_unit is None else depth_unit)


def _load_npy(path: Path) -> NDArray[Any]:
    try:
        return np.load(path, allow_pickle=False)
    except (ValueError, EOFError) as error:
        raise InputError(f"{path}: not a readable NPY file of numbers ({error}).") from None
