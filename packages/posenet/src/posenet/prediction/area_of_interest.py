"""The part of an image that is looked at: a mask of the bin, or a rectangle, in pixels of the depth image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class AreaOfInterest:
    """What `--mask` and `--roi` say: an image file, or "X0,Y0,X1,Y1"; with both, what lies in both."""

    file: Path | None = None
    rectangle: str | None = None

    def mask(self, camera: Camera) -> Mask | None:
        """The pixels (height, width) of the camera's images to look at; None for all.

        Raises:
            InputError: see :func:`read_mask` and :func:`parse_rectangle`; or the two have no pixel in common.
        """
        masks = []
        if self.file is not None:
            masks.append(read_mask(self.file, camera))
        if self.rectangle is not None:
            masks.append(parse_rectangle(self.rectangle, camera))
        if not masks:
            return None
        mask = np.logical_and.reduce(masks)
        if not mask.any():
            raise InputError(
                f"--roi {self.rectangle}: lies where the mask {self.file} is black; nothing is left to see."
            )
        return mask


def read_mask(path: Path | str, camera: Camera) -> Mask:
    """A mask (height, width) from an image file, True where it is not black.

    Raises:
        InputError: there is no such image, it is not of the camera's size, or black all over.
    """
    if not Path(path).is_file():
        raise InputError(f"--mask {path}: no such file; give an image that is white where the bin is.")
    values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if values is None:
        raise InputError(f"--mask {path}: not a readable image; give a PNG that is white where the bin is.")
    if values.shape[:2] != (camera.height, camera.width):
        raise InputError(
            f"--mask {path}: is {values.shape[1]} x {values.shape[0]} pixels, but the depth images have "
            f"{camera.width} x {camera.height}; give a mask of that size."
        )
    colors = values if values.ndim == 2 else values[:, :, :3]  # without the opacity
    mask = np.asarray(colors.reshape(camera.height, camera.width, -1).any(-1))
    if not mask.any():
        raise InputError(f"--mask {path}: is black all over, so nothing would be looked at; paint the bin white.")
    return mask


def parse_rectangle(words: str, camera: Camera) -> Mask:
    """A mask (height, width) of the pixels x0 <= x < x1, y0 <= y < y1 from "X0,Y0,X1,Y1".

    Raises:
        InputError: these are not four whole numbers, or no pixel of the image lies between them.
    """
    try:
        x0, y0, x1, y1 = (int(word) for word in words.split(","))
    except ValueError:
        raise InputError(
            f"--roi {words}: give four whole numbers X0,Y0,X1,Y1 in pixels, such as 100,80,540,400."
        ) from None
    mask = np.zeros((camera.height, camera.width), bool)
    mask[max(y0, 0) : max(y1, 0), max(x0, 0) : max(x1, 0)] = True
    if not mask.any():
        raise InputError(
            f"--roi {words}: holds no pixel of a depth image of {camera.width} x {camera.height}; X0 must be less than "
            "X1, Y0 less than Y1, and both within the image."
        )
    return mask


def cut_out(
    depths: Sequence[NDArray[np.float32]], camera: Camera, mask: Mask
) -> tuple[list[NDArray[np.float32]], Camera, tuple[int, int]]:
    """Images of a camera within a mask, no return (0) elsewhere, cropped to its bounds.

    Returns:
        The images, the camera of the cropped ones, and x0, y0 of the crop.

    Raises:
        InputError: the mask is not of the camera's size, or empty.
    """
    if mask.shape != (camera.height, camera.width):
        raise InputError(
            f"the mask is {' x '.join(map(str, mask.shape[::-1]))} pixels, but the camera says {camera.width} x "
            f"{camera.height}; give one of that size."
        )
    if not mask.any():
        raise InputError("the mask holds no pixel, so nothing would be looked at.")
    x0, y0, x1, y1 = bounds(mask)
    inside = mask[y0:y1, x0:x1]
    images = [np.where(inside, depth[y0:y1, x0:x1], np.float32(0.0)) for depth in depths]
    return images, replace(camera, width=x1 - x0, height=y1 - y0, cx=camera.cx - x0, cy=camera.cy - y0), (x0, y0)


def bounds(mask: Mask) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1 of the smallest rectangle around a mask that is not empty."""
    columns, rows = np.flatnonzero(mask.any(0)), np.flatnonzero(mask.any(1))
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1
