"""At which scale images train: the network knows objects of one size in pixels, and cameras show them in any."""

from __future__ import annotations

from dataclasses import dataclass

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera

LEAST_PIXELS = 6.0  # an object smaller than this shows nothing of its pose
NEAR = 0.06  # such a share off, a simple fraction is as good
TOLERATED = 1.2  # times the wanted size: so much larger, images are left as they are


@dataclass(frozen=True)
class WorkingScale:
    """A factor on both sides of the images, and the sentence that says why."""

    factor: float
    reason: str

    def camera(self, camera: Camera) -> Camera:
        """The camera of the images at this scale."""
        if self.factor == 1.0:
            return camera
        width, height = (max(1, round(self.factor * side)) for side in (camera.width, camera.height))
        return camera.sampled(width, height)


def choose_scale(
    camera: Camera, diameter: float, distance: float, wanted: float, asked: float | None = None
) -> WorkingScale:
    """The scale at which an object at the working distance is about `wanted` pixels across, never above 1.

    Args:
        camera: of the images as they are. diameter, distance: of the object and its median depth, in meters.
        wanted: pixels; 0 leaves images as they are. asked: a user's own factor.

    Raises:
        InputError: the object is too small to see, in the images as they are or at the scale that was asked for.
    """
    size = camera.fx * diameter / distance
    seen = f"at its median distance of {distance:.3g} m the object is {size:.3g} pixels across"
    if size < LEAST_PIXELS:
        raise InputError(
            f"the images of {camera.width} x {camera.height} are too coarse: {seen}, and nothing of its pose shows "
            f"below {LEAST_PIXELS:g}; use a longer focal length, more pixels, or a camera that is nearer."
        )
    if asked is not None:
        if asked * size < LEAST_PIXELS:
            raise InputError(
                f"--scale {asked:g}: {seen}, and {asked * size:.2g} would be left, where at least {LEAST_PIXELS:g} are "
                "needed; give a larger scale."
            )
        return WorkingScale(asked, f"as asked for with --scale; {seen}")
    if wanted == 0:
        return WorkingScale(1.0, f"the preset takes images as they are; {seen}")
    if size <= TOLERATED * wanted:
        return WorkingScale(1.0, f"{seen}, and {wanted:g} are enough for the network")
    return WorkingScale(_simple(wanted / size), f"{seen}, and about {wanted:g} train fastest")


def _simple(factor: float) -> float:
    """A half, a third and so on where that is near: each new pixel's ray is then exactly an old one's."""
    whole = round(1 / factor)
    return 1 / whole if abs(factor * whole - 1.0) < NEAR else factor
