"""Image files of anybody's: how large they are."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2

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
