"""The pinhole camera: OpenCV axes (x right, y down, z forward), integer pixel = pixel center."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evalkit.errors import InputError

log = logging.getLogger(__name__)
MAX_SIDE = 16384
LARGEST = 1e12  # no intrinsic is near it, and integers beyond 1e308 are no floats


@dataclass(frozen=True)
class Camera:
    """Intrinsics in pixels. The ray through integer pixel (u, v) is ((u - cx) / fx, (v - cy) / fy, 1)."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        numbers = (self.width, self.height, self.fx, self.fy, self.cx, self.cy)
        if not all(math.isfinite(value) for value in numbers):
            raise InputError(f"camera: {self} holds a number that is not finite; give finite intrinsics in pixels.")
        if not (0 < self.width <= MAX_SIDE and 0 < self.height <= MAX_SIDE):
            raise InputError(f"camera: {self.width} x {self.height} pixels; each side must be 1 to {MAX_SIDE}.")
        if self.fx <= 0 or self.fy <= 0:
            raise InputError(f"camera: focal lengths fx={self.fx:g}, fy={self.fy:g} must be positive pixels.")

    @property
    def matrix(self) -> NDArray[np.float64]:
        """K (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Points (..., 3) in meters, camera frame, to pixels (..., 2)."""
        points = np.asarray(points, float)
        x, y, z = np.moveaxis(points, -1, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.stack([self.fx * x / z + self.cx, self.fy * y / z + self.cy], -1)

    def unproject(self, pixels: ArrayLike, depth: ArrayLike) -> NDArray[np.float64]:
        """Pixels (..., 2) and axial depth (...) in meters to points (..., 3) in the camera frame."""
        pixels, z = np.asarray(pixels, float), np.asarray(depth, float)
        return np.stack([(pixels[..., 0] - self.cx) / self.fx * z, (pixels[..., 1] - self.cy) / self.fy * z, z], -1)

    def point_map(self, depth: ArrayLike) -> NDArray[np.float64]:
        """A depth image (height, width) in meters to its points (height, width, 3); depth 0 gives (0, 0, 0)."""
        v, u = np.mgrid[: self.height, : self.width]
        return self.unproject(np.stack([u, v], -1), depth)

    def resized(self, width: int, height: int) -> Camera:
        """The same view on another pixel grid; pixel *areas* map onto each other, hence the half pixels."""
        sx, sy = width / self.width, height / self.height
        cx, cy = (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5
        return Camera(width, height, self.fx * sx, self.fy * sy, cx, cy)

    def sampled(self, width: int, height: int) -> Camera:
        """The camera of an image of that size that takes the nearest pixel of this camera's for each of its own.

        As :meth:`resized`, but the principal point lies where the pixels that were taken say. Of two pixels that are
        equally near, sampling takes the right and lower one: at half the size each ray is half a pixel farther on than
        `resized` has it.
        """
        grid = self.resized(width, height)
        cx = _sampled_principal(self.cx, self.width, width)
        cy = _sampled_principal(self.cy, self.height, height)
        return replace(grid, cx=cx, cy=cy)

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_json(cls, document: Any, where: str = "camera") -> Camera:
        """Read ``{"width", "height", "fx", "fy", "cx", "cy"}``.

        Raises:
            InputError: a field is missing or not a number.
        """
        if not isinstance(document, dict):
            raise InputError(f"{where}: expected an object with width, height, fx, fy, cx, cy.")
        values: dict[str, float] = {}
        for field in ("width", "height", "fx", "fy", "cx", "cy"):
            value = document.get(field)
            if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > LARGEST:
                raise InputError(f"{where}: the field '{field}' is missing or not a number of sane size.")
            values[field] = value
        for field in ("width", "height"):
            if values[field] != int(values[field]) if math.isfinite(values[field]) else True:
                raise InputError(f"{where}: '{field}' must be a whole number of pixels.")
        try:
            return cls(
                int(values["width"]), int(values["height"]), *(float(values[k]) for k in ("fx", "fy", "cx", "cy"))
            )
        except InputError as error:
            raise InputError(f"{where}: {error}") from None

    @classmethod
    def load(cls, path: Path | str, image_size: Callable[[], tuple[int, int]] | None = None) -> Camera:
        """Read the pinhole camera of any file that :func:`evalkit.geometry.camera_files.read_camera` knows.

        `image_size` gives width and height where the file holds nothing but a camera matrix, and a warning says so.
        What the file has beyond it, such as distortion, is logged as a warning; `read_camera` gives it.

        Raises:
            InputError: the file holds no pinhole camera.
        """
        from evalkit.geometry.camera_files import distortion_warning, read_camera

        found = read_camera(path, image_size=image_size)
        for remark in found.remarks:
            log.warning(remark)
        if found.lens is not None:
            log.warning("%s: %s", path, distortion_warning(found.lens))
        return found.camera


def nearest_pixels(count: int, of: int) -> NDArray[np.int64]:
    """Which of `of` pixels in a row (or column) each of `count` pixels takes that stand for the same length."""
    return np.minimum(((np.arange(count) + 0.5) * (of / count)).astype(np.int64), of - 1)


def _sampled_principal(principal: float, of: int, count: int) -> float:
    """Where, in pixels of the sampled row, the ray of `principal` lies: the mean over all samples."""
    return float(np.mean(np.arange(count) - (nearest_pixels(count, of) - principal) * (count / of)))
