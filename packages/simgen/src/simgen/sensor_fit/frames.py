"""The depth images that a sensor is fitted to: read, checked, cut to what they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera

LEAST_FRAMES = 3
MOST_FRAMES = 12  # evenly picked of more; more change nothing
LEAST_RETURNS = 2000  # pixels of an image
STATIC_SHARE = 0.75  # of the pixels that must agree for images to show one scene
AROUND = 24  # pixels kept around what returns

Image = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class FitFrames:
    """Depth images (H, W) in meters, 0 = no return, of one camera; `static` where they show one scene."""

    names: tuple[str, ...]
    depths: tuple[Image, ...]
    camera: Camera
    static: bool

    @property
    def distances(self) -> tuple[float, float]:
        """Meters within which nine tenths of the returns lie."""
        low, high = np.percentile(np.concatenate([depth[depth > 0] for depth in self.depths]), [5, 95])
        return float(low), float(high)


def checked_frames(names: Sequence[str], depths: Sequence[Image], cameras: Sequence[Camera], where: str) -> FitFrames:
    """The images as a fit wants them, cut to the part in which anything returns.

    Raises:
        InputError: there are fewer than three, they differ in size, or one shows nothing to measure by.
    """
    if len(depths) < LEAST_FRAMES:
        raise InputError(
            f"{where}: holds {len(depths)} depth image{'s' * (len(depths) != 1)}, and a sensor is fitted to at least "
            f"{LEAST_FRAMES}; take more."
        )
    camera = cameras[0]
    for name, depth, own in zip(names, depths, cameras, strict=True):
        if own != camera or depth.shape != (camera.height, camera.width):
            raise InputError(f"{where}: '{name}' is of another size or camera than '{names[0]}'; give one camera's.")
        _require_measured(depth, f"{where}: '{name}'")
    seen = np.any([depth > 0 for depth in depths], axis=0)
    rows, columns = np.flatnonzero(seen.any(1)), np.flatnonzero(seen.any(0))
    top, left = max(rows[0] - AROUND, 0), max(columns[0] - AROUND, 0)
    cut = tuple(np.ascontiguousarray(d[top : rows[-1] + AROUND, left : columns[-1] + AROUND]) for d in depths)
    height, width = cut[0].shape
    window = replace(camera, width=width, height=height, cx=camera.cx - left, cy=camera.cy - top)
    return FitFrames(tuple(names), cut, window, _is_static(cut))


def _require_measured(depth: Image, where: str) -> None:
    returned = depth[depth > 0]
    if len(returned) < LEAST_RETURNS:
        raise InputError(f"{where} is empty or nearly so ({len(returned)} returns); leave it out.")
    if len(returned) and (returned == returned.max()).mean() > 0.5:
        raise InputError(
            f"{where} holds the same depth, {returned.max():g} m, in most pixels, as saturated images do; leave it "
            "out, or say which value means no return with --no-return."
        )


def _is_static(depths: Sequence[Image]) -> bool:
    """Whether the images show one scene: most pixels' depths agree better than those of two heaps ever do."""
    first = depths[0]
    for other in depths[1:]:
        both = (first > 0) & (other > 0)
        tolerance = 0.01 * first[both]
        if both.sum() < LEAST_RETURNS / 2 or (np.abs(first - other)[both] < tolerance).mean() < STATIC_SHARE:
            return False
        steep = np.abs(np.diff(first, axis=1)) > 0.01 * first[:, 1:]
        across = steep & both[:, 1:]
        if across.sum() > 50 and (np.abs(first - other)[:, 1:][across] < 0.01 * first[:, 1:][across]).mean() < 0.5:
            return False  # flat ground agrees always; what stands on it does not
    return True
