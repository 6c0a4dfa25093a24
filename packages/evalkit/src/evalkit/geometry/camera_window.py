"""The part of the sensor that an image shows: the region of interest and the binning of a ROS camera_info."""

from __future__ import annotations

from dataclasses import dataclass

from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.geometry.camera_fields import Fields, number

MOST_BINNED = 16


@dataclass(frozen=True)
class Window:
    """A rectangle of the full image, in its pixels, whose pixels are then joined into larger ones."""

    full: tuple[int, int]  # width, height of the image that the intrinsics speak of
    left: int = 0
    top: int = 0
    width: int = 0  # 0: all of it
    height: int = 0
    binning_x: int = 1
    binning_y: int = 1

    def of(self, camera: Camera, where: str) -> Camera:
        """The camera of the windowed, binned image.

        Raises:
            InputError: nothing is left of the image, or the window leaves the principal point far outside.
        """
        width, height = self.width or self.full[0], self.height or self.full[1]
        cut = Camera(width, height, camera.fx, camera.fy, camera.cx - self.left, camera.cy - self.top)
        outside = not (0 <= cut.cx < width and 0 <= cut.cy < height)
        if (self.left or self.top) and outside and 0 <= camera.cx < width and 0 <= camera.cy < height:
            raise InputError(
                f"{where}: its roi and its principal point contradict each other, for the point would lie outside the "
                "window; if the matrix speaks of the window already, set the roi to zeros."
            )
        if self.binning_x == self.binning_y == 1:
            return cut
        if width < self.binning_x or height < self.binning_y:
            raise InputError(f"{where}: its binning leaves no pixel of {width} x {height}; mend binning_x, binning_y.")
        return cut.resized(width // self.binning_x, height // self.binning_y)


def windowed(size: tuple[int, int], fields: Fields, where: str) -> tuple[Window, list[str]]:
    """The window that a camera file's fields speak of, and a remark where there is one.

    By the definition of camera_info, width, height and K are those of the whole sensor, the roi is in its pixels, and
    binning comes after it. Some drivers give the window's size as width and height; the roi then reaches beyond them.

    Raises:
        InputError: the fields make no sense together.
    """
    binning = [_whole(fields, name, where) or 1 for name in ("binningx", "binningy")]
    if max(binning) > MOST_BINNED:
        raise InputError(f"{where}: pixels binned by {binning[0]} x {binning[1]} make no sense; mend the binning.")
    roi = fields.get("roi") or {}
    if not isinstance(roi, dict):
        raise InputError(f"{where}: 'roi' must hold x_offset, y_offset, width and height.")
    left, top, width, height = (_whole(roi, name, where) for name in ("x_offset", "y_offset", "width", "height"))
    width, height = width or (size[0] - left), height or (size[1] - top)
    if (width, height) == size and (left or top):
        size = left + width, top + height  # the driver gave the window's size; the sensor reaches at least so far
    if min(width, height) <= 0 or left + width > size[0] or top + height > size[1]:
        raise InputError(
            f"{where}: its roi of {width} x {height} pixels at {left}, {top} is no part of the image of {size[0]} x "
            f"{size[1]}; mend one of them."
        )
    window = Window(size, left, top, width, height, *binning)
    remarks = []
    if (width, height) != size:
        remarks.append(f"the roi of {width} x {height} pixels at {left}, {top} is applied.")
    if max(binning) > 1:
        remarks.append(f"the binning of {binning[0]} x {binning[1]} pixels is applied.")
    return window, remarks


def _whole(fields: Fields, name: str, where: str) -> int:
    if fields.get(name) is None:
        return 0
    value = number(fields, name, where)
    if value != int(value) or value < 0:
        raise InputError(f"{where}: '{name}' must be a whole number of pixels.")
    return int(value)
