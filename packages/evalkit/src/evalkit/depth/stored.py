"""The numbers of depth image files as they are stored, in whatever format."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import cv2
import numpy as np
from numpy.typing import NDArray

from evalkit.depth.exr import read_exr
from evalkit.errors import InputError

SUFFIXES = (".png", ".tif", ".tiff", ".npy", ".npz", ".pgm", ".exr")
KINDS = "a 16-bit PNG or PGM, a TIFF, NPY, NPZ or EXR file, or an organized point cloud (PLY, PCD)"
DEPTH_NAME = re.compile(r"depth|(^|[^a-z])z16([^a-z0-9]|$)", re.IGNORECASE)
DISPARITY_NAME = re.compile(r"(^|[^a-z])disp(arity|arities)?([^a-z]|$)", re.IGNORECASE)
# What others write that is read nowhere here, and what to write instead.
USELESS = {
    ".jpg": "a JPEG holds no depth", ".jpeg": "a JPEG holds no depth", ".bmp": "an 8-bit image holds no depth",
    ".raw": "raw bytes say neither size nor type", ".bin": "raw bytes say neither size nor type",
    ".mat": "MATLAB's files are not read", ".csv": "text is not read", ".txt": "text is not read",
    ".pfm": "a portable float map mostly holds disparities", ".bag": "recordings are not read",
    ".db3": "recordings are not read", ".mcap": "recordings are not read", ".zdf": "Zivid's own files are not read",
    ".pkl": "nothing is unpickled", ".h5": "it is no shard of ours", ".hdf5": "it is no shard of ours",
}  # fmt: skip


def read_values(path: Path) -> NDArray[Any]:
    """The numbers of a one-channel image (height, width).

    Raises:
        InputError: the file is missing, of another kind, holds several images or channels, or no depth.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such depth image; check the path.")
    suffix = path.suffix.lower()
    if suffix in USELESS:
        raise InputError(f"{path}: {USELESS[suffix]}; save depth as {KINDS}.")
    if DISPARITY_NAME.search(path.stem) and not DEPTH_NAME.search(path.stem):
        raise InputError(
            f"{path}: by its name it holds disparities; depth is focal length times baseline over disparity, so save "
            "that (and name it otherwise if it is depth already)."
        )
    values = _LOADERS.get(suffix, _load_image)(path)
    if values is None:
        raise InputError(f"{path}: not a readable image; give {KINDS}.")
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[:, :, 0]
    if values.ndim != 2 or values.size == 0:
        raise InputError(f"{path}: has the shape {values.shape}, and a depth image has one channel (height, width).")
    if values.dtype == np.uint8:
        raise InputError(f"{path}: an 8-bit image holds no metric depth; save depth as a 16-bit PNG, TIFF or NPY.")
    if values.dtype.kind not in "uif":
        raise InputError(f"{path}: holds values of type {values.dtype}, and depth is a number.")
    return values


def _load_image(path: Path) -> NDArray[Any] | None:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


def _load_tiff(path: Path) -> NDArray[Any] | None:
    pages = cv2.imcount(str(path), cv2.IMREAD_UNCHANGED)
    if pages > 1:
        raise InputError(f"{path}: holds {pages} images, and which is depth it does not say; save each as a file.")
    return _load_image(path)


def _load_npy(path: Path) -> NDArray[Any] | None:
    try:
        values = np.load(path, allow_pickle=False)
    except (ValueError, EOFError) as error:
        raise InputError(f"{path}: not a readable NPY file of numbers ({error}).") from None
    return values if isinstance(values, np.ndarray) else None


def _load_npz(path: Path) -> NDArray[Any]:
    """The only image in the archive, or the only one called depth."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (ValueError, EOFError, OSError, TypeError, AttributeError, BadZipFile) as error:
        raise InputError(f"{path}: not a readable NPZ file of numbers ({str(error)[:120]}).") from None
    images = [name for name, values in arrays.items() if values.ndim == 2 and min(values.shape) > 4]
    named = [name for name in images if DEPTH_NAME.search(name)] or images
    if len(named) != 1:
        listed = ", ".join(sorted(arrays))[:80]
        raise InputError(
            f"{path}: which of its arrays ({listed}) is depth? Save it alone, or as 'depth' (height, width)."
        )
    return arrays[named[0]]


_LOADERS: dict[str, Callable[[Path], NDArray[Any] | None]] = {
    ".npy": _load_npy, ".npz": _load_npz, ".exr": read_exr, ".tif": _load_tiff, ".tiff": _load_tiff,
}  # fmt: skip
