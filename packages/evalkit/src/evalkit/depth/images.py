"""Depth images from files: what users have on disk, as meters."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.depth import point_cloud, stored
from evalkit.depth.no_return import lone_value, without_code
from evalkit.depth.stored import read_values
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.geometry.lens import Lens

log = logging.getLogger(__name__)
SUFFIXES = (*stored.SUFFIXES, *point_cloud.SUFFIXES)
FARTHEST = 50.0  # meters; what is farther at the median is in another unit
TURNS = (0, 90, 180, 270)


@dataclass(frozen=True)
class Reading:
    """How depth files are to be read, where they do not say it themselves.

    Attributes:
        depth_unit: meters a step of the file's values; None: meters in floating-point files, refused in others.
        integer_unit: the same for whole numbers only, where the camera's file says it.
        no_return: the stored value that means "no return"; None recognizes saturated values.
        along_ray: depth is the distance from the camera along each pixel's ray, not along its axis.
        turned: degrees by which images must be turned clockwise to be the camera's.
        lens: what distorts the images; they are rectified to the camera.
    """

    depth_unit: float | None = None
    integer_unit: float | None = None
    no_return: float | None = None
    along_ray: bool = False
    turned: int = 0
    lens: Lens | None = None

    def image(self, path: Path, camera: Camera) -> NDArray[np.float32]:
        """The image (height, width) as `camera` would have taken it: axial z in meters, 0 = no return.

        Raises:
            InputError: the file cannot be used, or is not of the camera's size.
        """
        if path.suffix.lower() in point_cloud.SUFFIXES:
            grid = point_cloud.read_grid(path, camera)
            if self.lens is None and self.turned == 0:
                point_cloud.require_camera(grid, camera, path)
            depth = _in_meters(np.nan_to_num(grid[..., 2]), self.depth_unit, path)
            return self._as_taken_by(camera, depth, path)
        depth = self._as_taken_by(camera, read_depth(path, self.depth_unit, self.no_return, self.integer_unit), path)
        return depth * _cosines(camera) if self.along_ray else depth

    def size(self, path: Path) -> tuple[int, int]:
        """Width and height of the image, turned.

        Raises:
            InputError: the file cannot be used.
        """
        is_cloud = path.suffix.lower() in point_cloud.SUFFIXES
        height, width = (point_cloud.read_grid(path) if is_cloud else read_values(path)).shape[:2]
        return (width, height) if self.turned % 180 == 0 else (height, width)

    def _as_taken_by(self, camera: Camera, depth: NDArray[np.float32], path: Path) -> NDArray[np.float32]:
        depth = np.rot90(depth, -self.turned // 90)
        if depth.shape != (camera.height, camera.width):
            height, width = depth.shape
            swapped = (width, height) == (camera.height, camera.width) and self.turned == 0
            mend = (
                "it lies on its side: turn it with --rotate 90 or --rotate 270"
                if swapped
                else "give the camera that took it"
            )
            raise InputError(
                f"{path}: is {width} x {height} pixels but the camera says {camera.width} x {camera.height}; {mend}."
            )
        return depth if self.lens is None else self.lens.rectify(depth, camera)


def read_depth(
    path: Path | str, depth_unit: float | None, no_return: float | None = None, integer_unit: float | None = None
) -> NDArray[np.float32]:
    """A depth image (height, width) in meters from a file of `evalkit.depth.stored`'s kinds; 0 = no return.

    `depth_unit` is the meters that one step of the file's values stands for; integer images need it, floating-point
    ones are meters without it; `integer_unit` stands in for it with integers only. `no_return` is the stored value that
    means "no return"; without it, saturated values are recognized, and that is logged.

    Raises:
        InputError: the file is missing, of another kind, has several channels, is an integer image without a unit, or
            its numbers cannot be meters.
    """
    path = Path(path)
    values = read_values(path)
    if values.dtype.kind != "f":
        depth_unit = integer_unit if depth_unit is None else depth_unit
    if depth_unit is None and values.dtype.kind != "f":
        raise InputError(f"{path}: holds whole numbers; say what one step is in meters, e.g. --depth-unit 0.001.")
    if (values < 0).any() and not (values > 0).any():
        raise InputError(f"{path}: its depths are all negative, as along OpenGL's axis; save them with the other sign.")
    values, code = without_code(values, no_return)
    if no_return is None:
        _remark(code, lone_value(values), str(path.parent))
    return _in_meters(values, depth_unit, path)


@lru_cache(maxsize=256)  # once a folder
def _remark(code: float | None, suspect: float | None, folder: str) -> None:
    """Say what counts as no return, and what may."""
    if code is not None:
        log.info("%s: the value %g counts as no return; where it is none, say --no-return 0.", folder, code)
    elif suspect is not None:
        log.info(
            "%s: the value %g stands in many pixels and far beyond all others; if it means no return, say "
            "--no-return %g.", folder, suspect, suspect,
        )  # fmt: skip


def _in_meters(values: NDArray[Any], depth_unit: float | None, path: Path) -> NDArray[np.float32]:
    """Stored values as meters, 0 where nothing returned."""
    with np.errstate(over="ignore", invalid="ignore"):
        depth = np.nan_to_num(values.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        depth = np.maximum(depth, 0.0) * np.float32(1.0 if depth_unit is None else depth_unit)
    median = float(np.median(depth[depth > 0])) if (depth > 0).any() else 0.0
    if median == 0.0:
        log.warning("%s: holds no return at all.", path)
    elif depth_unit is None and depth.max() == 1.0:
        log.warning("%s: its values end at exactly 1, as of an image stretched for display; depth is in meters.", path)
    if depth_unit is None and median > FARTHEST:
        raise InputError(
            f"{path}: its depths ({median:.4g} at the median) cannot be meters; say the unit, for millimeters "
            "--depth-unit 0.001."
        )
    return depth


def _cosines(camera: Camera) -> NDArray[np.float32]:
    """Axial depth over distance along the ray, for every pixel (height, width)."""
    rays = camera.point_map(np.ones((camera.height, camera.width)))
    return (1.0 / np.linalg.norm(rays, axis=-1)).astype(np.float32)
