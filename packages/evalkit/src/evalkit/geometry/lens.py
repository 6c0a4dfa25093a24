"""What a lens does between a pinhole camera and the image as it is taken: distortion and skew."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera

Array = NDArray[np.float64]
COEFFICIENTS = (4, 5, 8, 12, 14)  # numbers of coefficients that OpenCV knows
TILT = slice(12, 14)  # of the sensor (Scheimpflug); not modeled here
INVERSION_STEPS = 30
RADII = 512  # at which it is checked that a larger angle lies farther out in the image


@dataclass(frozen=True)
class Lens:
    """Distortion after Brown and Conrady, as OpenCV has it, and skew.

    A point at (x, y) = (X / Z, Y / Z) appears at (x', y') of :meth:`distort` and in pixel
    (fx x' + skew y' + cx, fy y' + cy), where fx, fy, cx, cy are those of the pinhole camera that the lens belongs to.

    Attributes:
        coefficients: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4]]] in OpenCV's order; those left out are zero.
        skew: pixels.
        inverse: the polynomial leads from the image to the ideal point ("inverse Brown-Conrady"), not the other way.
        radial_first: the tangential part is taken of the point moved by the radial one ("modified Brown-Conrady").
    """

    coefficients: tuple[float, ...] = ()
    skew: float = 0.0
    inverse: bool = False
    radial_first: bool = False

    def __post_init__(self) -> None:
        if self.coefficients and len(self.coefficients) not in COEFFICIENTS:
            raise InputError(
                f"{len(self.coefficients)} distortion coefficients; OpenCV's models have {_listed(COEFFICIENTS)}."
            )
        if any(self.coefficients[TILT]):
            raise InputError("a tilted sensor (tau) is not modeled; rectify the images with the camera's own software.")

    def distort(self, points: Array) -> Array:
        """Ideal points (..., 2) at z = 1 to where they appear (..., 2); NaN where the model folds over itself."""
        points = np.asarray(points, float)
        if not self.coefficients:
            return points
        moved = self._inverted(points) if self.inverse else self._moved(points)
        return np.where((np.linalg.norm(points, axis=-1) < self._fold(points))[..., None], moved, np.nan)

    def image_pixels(self, camera: Camera) -> Array:
        """For every pixel of the ideal camera, the pixel (height, width, 2) of the image as taken that shows it."""
        v, u = np.mgrid[: camera.height, : camera.width]
        ideal = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy], -1)
        x, y = np.moveaxis(self.distort(ideal), -1, 0)
        return np.stack([camera.fx * x + self.skew * y + camera.cx, camera.fy * y + camera.cy], -1)

    def rectify(self, depth: NDArray[Any], camera: Camera) -> NDArray[Any]:
        """The image (height, width) that the ideal camera would have taken; 0 where this one saw nothing.

        Nearest pixels: the mean of two depths is the depth of nothing. Depth along z is the same in both images.

        Raises:
            InputError: the image is not of the camera's size.
        """
        if depth.shape != (camera.height, camera.width):
            raise InputError(
                f"the depth image is {depth.shape[1]} x {depth.shape[0]} pixels but the camera says "
                f"{camera.width} x {camera.height}; give the camera that took it."
            )
        pixels = np.nan_to_num(self.image_pixels(camera), nan=-1.0, posinf=-1.0, neginf=-1.0)
        u, v = np.moveaxis(np.clip(np.round(pixels), -1, 2 * 16384).astype(int), -1, 0)
        inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        found = depth[np.clip(v, 0, camera.height - 1), np.clip(u, 0, camera.width - 1)]
        return np.where(inside, found, np.zeros((), depth.dtype))

    def describe(self) -> str:
        names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
        parts = [f"{n} {c:.4g}" for n, c in zip(names, self.coefficients, strict=False) if c]
        return ", ".join(parts + ([f"skew {self.skew:.4g} pixels"] if self.skew else []))

    def _moved(self, points: Array) -> Array:
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = (*self.coefficients, *[0.0] * 12)[:12]
        with np.errstate(all="ignore"):  # far outside the image the polynomial overflows
            x, y = np.moveaxis(points, -1, 0)
            r2 = x * x + y * y
            radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
            xr, yr = x * radial, y * radial
            xt, yt = (xr, yr) if self.radial_first else (x, y)
            dx = 2 * p1 * xt * yt + p2 * (r2 + 2 * xt * xt) + r2 * (s1 + s2 * r2)
            dy = p1 * (r2 + 2 * yt * yt) + 2 * p2 * xt * yt + r2 * (s3 + s4 * r2)
            return np.stack([xr + dx, yr + dy], -1)

    def _inverted(self, points: Array) -> Array:
        """What the polynomial maps to `points`, by fixed-point iteration, as the shift of a lens is small."""
        guess = points
        for _ in range(INVERSION_STEPS):
            guess = guess - (self._moved(guess) - points)
        return guess

    def _fold(self, points: Array) -> float:
        """The radius from which on a larger angle no longer lies farther out: there the model means nothing."""
        farthest = max(float(np.linalg.norm(points, axis=-1).max(initial=0.0)), 1e-9)
        radii = np.linspace(0.0, 2 * farthest, RADII)
        moved = self._moved(np.stack([radii, np.zeros_like(radii)], -1))[:, 0]
        falling = np.flatnonzero(~(np.diff(moved) > 0))
        if len(falling) == 0:
            return np.inf
        return float((moved if self.inverse else radii)[falling[0]])


def _listed(counts: tuple[int, ...]) -> str:
    return ", ".join(map(str, counts[:-1])) + f" or {counts[-1]}"
