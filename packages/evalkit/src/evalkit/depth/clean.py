"""Depth as numbers that can be computed with: meters, 0 where nothing returned."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.depth.no_return import without_code
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera

log = logging.getLogger(__name__)


def clean_depth(depth: NDArray[Any], camera: Camera, title: str = "the depth image") -> NDArray[np.float32]:
    """The image (height, width) as float32, 0 where nothing returned: NaN, infinity, negative and saturated depths too.

    Raises:
        InputError: it is not of the camera's size, or holds no numbers.
    """
    depth = np.asarray(depth)
    if depth.shape != (camera.height, camera.width):
        raise InputError(
            f"{title} is {' x '.join(map(str, depth.shape[::-1]))} pixels but the camera says "
            f"{camera.width} x {camera.height}; give the camera that took it."
        )
    if depth.dtype.kind not in "uif":
        raise InputError(f"{title} holds values of type {depth.dtype}, and depth is meters.")
    depth, code = without_code(depth)
    if code is not None:
        log.info("%s: depths of %g count as no return.", title, code)
    with np.errstate(over="ignore"):
        clean = np.nan_to_num(depth.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    return np.maximum(clean, 0.0)
