"""Depth images from files: what users have on disk, as metres."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError

SUFFIXES = (".png", ".tif", ".tiff", ".npy")
HIGHEST = 65535  # of a 16-bit image


def read_depth(path: Path | str, depth_unit: float | None) -> NDArray[np.float32]:
    """A depth image (height, width) in metres from a 16-bit PNG, a TIFF or an NPY file.

    `depth_unit` is the metres that one step of the file's values stands for; integer images need it, floating-point
    ones are metres without it.

    Raises:
        InputError: the file is missing, of another kind, has several channels, or is an integer image without a unit.
    """
    values = _read_values(Path(path))
    if depth_unit is None and values.dtype.kind != "f":
        raise InputError(f"{path}: holds whole numbers; say what one step is in metres, e.g. --depth-unit 0.001.")
    return values.astype(np.float32) * np.float32(1.0 if depth_unit is None else depth_unit)


def read_clipped_depth(path: Path | str, clip: tuple[float, float]) -> NDArray[np.float32]:
    """A 16-bit image (height, width) whose values run linearly between two depths, as metres: the Siléane coding.

    Both ends of the scale mean no return: what lies at or beyond a clipping plane was not seen.

    Raises:
        InputError: the file is missing or is no 16-bit image of one channel.
    """
    values = _read_values(Path(path))
    if values.dtype != np.uint16:
        raise InputError(f"{path}: holds {values.dtype} values, and a Siléane depth image is a 16-bit PNG.")
    near, far = clip
    depth = near + (far - near) / HIGHEST * values.astype(np.float32)
    return np.where((values > 0) & (values < HIGHEST), depth, 0.0).astype(np.float32)


def _read_values(path: Path) -> NDArray[Any]:
    """The numbers of a one-channel image (height, width) as they are stored."""
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
    return values


def _load_npy(path: Path) -> NDArray[Any] | None:
    try:
        values = np.load(path, allow_pickle=False)
    except (ValueError, EOFError) as error:
        raise InputError(f"{path}: not a readable NPY file of numbers ({error}).") from None
    return values if isinstance(values, np.ndarray) else None
