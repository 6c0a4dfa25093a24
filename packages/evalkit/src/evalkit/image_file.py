"""Image files of anybody's: how large they are, and whether they can hold depth."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2

from evalkit.errors import InputError

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
GRAY = 0  # PNG's color type of one channel


def image_size(path: Path) -> tuple[int, int]:
    """Width and height of an image; of a PNG only the header is read.

    Raises:
        InputError: it is no image.
    """
    header = _png_header(path)
    if header is not None:
        return header[0], header[1]
    values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if values is None:
        raise InputError(f"{path}: is not a readable image; fetch it again.")
    return values.shape[1], values.shape[0]


def is_picture(path: Path) -> bool:
    """Whether a file is a PNG of 8 bits or of colors, which holds no depth but often stands beside it."""
    header = _png_header(path)
    return header is not None and (header[2] <= 8 or header[3] != GRAY)


def _png_header(path: Path) -> tuple[int, int, int, int] | None:
    """Width, height, bits a channel and color type of a PNG; None of anything else."""
    with open(path, "rb") as file:
        head = file.read(26)
    if len(head) < 26 or head[:8] != PNG_SIGNATURE or head[12:16] != b"IHDR":
        return None
    width, height, bits, color = struct.unpack(">IIBB", head[16:26])
    return width, height, bits, color
