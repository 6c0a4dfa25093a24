"""Depth images as datasets store them: how large they are, and what they hold."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def image_size(path: Path) -> tuple[int, int]:
    """Width and height of an image; of a PNG only the header is read.

    Raises:
        InputError: it is no image.
    """
    with open(path, "rb") as file:
        head = file.read(24)
    if head[:8] == PNG_SIGNATURE and head[12:16] == b"IHDR":
        width, height = struct.unpack(">II", head[16:24])
        return width, height
    values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if values is None:
        raise InputError(f"{path}: is not a readable image; fetch it again.")
    return values.shape[1], values.shape[0]


def read_raw_depth(path: Path) -> NDArray[Any]:
    """The stored values (height, width) of a single-channel image of 16 bits or floats.

    Raises:
        InputError: there is no such file, or it is another kind of image.
    """
    values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.is_file() else None
    if values is None:
        raise InputError(f"{path}: no readable depth image; fetch the dataset's depth images.")
    if values.ndim != 2 or values.dtype not in (np.uint16, np.float32):
        raise InputError(
            f"{path}: a depth image has one channel of 16 bits; this one is {values.dtype} {values.shape}."
        )
    return values
