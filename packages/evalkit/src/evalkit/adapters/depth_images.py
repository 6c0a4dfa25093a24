"""Depth images as datasets store them: how large they are, what they hold, and all of them in one coding."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import atomic_path, write_json
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera

DEPTH_UNIT = 1e-4  # meters a step of what is written; the farthest is 6.55 m
HIGHEST = np.iinfo(np.uint16).max
FAST_PNG = 1  # zlib's level; masks and depth gain little from more


@dataclass(frozen=True)
class DepthImage:
    """A depth image by the id that gt.json knows it by; `read` gives it (height, width) in meters, 0 = no return."""

    id: str
    camera: Camera
    read: Callable[[], NDArray[np.float64]]


def write_depth_images(folder: Path, images: Iterable[DepthImage]) -> dict[Path, int]:
    """Write FOLDER/ID.png, 16 bits, a tenth of a millimeter a step, and FOLDER/camera.json; how many are in a folder.

    The camera's file says the step as BOP's does (depth_scale, in millimeters).
    Images of several cameras go to a folder each, FOLDER/camera-00 and so on. What is beyond 6.55 m is left out (0).
    """
    by_camera: dict[Camera, list[DepthImage]] = {}
    for image in images:
        by_camera.setdefault(image.camera, []).append(image)
    counts = {}
    for number, (camera, members) in enumerate(by_camera.items()):
        target = folder if len(by_camera) == 1 else folder / f"camera-{number:02d}"
        write_json(target / "camera.json", camera.to_json() | {"depth_scale": 1e3 * DEPTH_UNIT})
        for image in members:
            _write_png(target / f"{image.id}.png", image)
        counts[target] = len(members)
    return counts


def _write_png(path: Path, image: DepthImage) -> None:
    depth = image.read()
    if depth.shape != (image.camera.height, image.camera.width):
        found = "x".join(str(side) for side in depth.shape[::-1])
        raise InputError(f"image '{image.id}' is {found} pixels, not {image.camera.width}x{image.camera.height}.")
    steps = np.round(depth / DEPTH_UNIT)
    encoded = cv2.imencode(".png", np.where(steps <= HIGHEST, steps, 0).astype(np.uint16))[1]
    with atomic_path(path) as temporary:
        temporary.write_bytes(encoded.tobytes())


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


def write_png(path: Path, values: NDArray[Any]) -> None:
    """Write a single-channel image of 8 or 16 bits as it is, without a temporary: for folders that appear as a whole.

    Raises:
        OSError: the file cannot be written.
    """
    path.write_bytes(cv2.imencode(".png", values, [cv2.IMWRITE_PNG_COMPRESSION, FAST_PNG])[1].tobytes())


def between_clip_planes(raw: NDArray[Any], near: float, far: float) -> NDArray[np.float64]:
    """Meters of 16-bit values that run linearly between two clipping planes; both ends mean no return."""
    depth = near + (far - near) * raw.astype(float) / HIGHEST
    return np.where((raw > 0) & (raw < HIGHEST), depth, 0.0)
