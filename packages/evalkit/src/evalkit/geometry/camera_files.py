"""Cameras as other people's files describe them: the pinhole camera, the lens before it, and what was chosen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.errors import InputError
from evalkit.geometry import camera_text
from evalkit.geometry.camera import Camera
from evalkit.geometry.camera_choice import chosen_camera, split_selector
from evalkit.geometry.camera_fields import Fields, number, numbers
from evalkit.geometry.camera_lens import lens_of, refuse_fisheye
from evalkit.geometry.camera_matrix import SAME_PIXELS, camera_matrix, is_by_columns, matrix_field
from evalkit.geometry.camera_size import (
    ImageSize,
    counted_from_centers,
    expanded,
    from_angle,
    image_size_of,
    require_fitting,
)
from evalkit.geometry.camera_window import windowed
from evalkit.geometry.lens import Lens

BOP_SCALES = (0.01, 10.0)  # millimeters a step; a depth_scale beyond is of another convention
UNITS = (1e-6, 1e-2)  # meters a step that a depth_unit may say


@dataclass(frozen=True)
class CameraFile:
    """What a camera file says.

    Attributes:
        camera: the pinhole camera. Images as taken are its images only where `lens` is None.
        lens: what distorts the images as taken; ``lens.rectify(depth, camera)`` makes them the pinhole camera's.
        remarks: sentences on what the file has beyond a pinhole camera, and which of its fields were followed.
        depth_unit: meters a step of its depth images, where the file says so (BOP's depth_scale).
    """

    camera: Camera
    lens: Lens | None = None
    remarks: tuple[str, ...] = ()
    depth_unit: float | None = None


def read_camera(path: Path | str, rectified: bool = False, image_size: ImageSize | None = None) -> CameraFile:
    """Read the camera of a file; docs/own-camera.md lists whose.

    Args:
        path: the file, or ``FILE#NAME`` for one of several cameras in it.
        rectified: the images were rectified; they then follow the projection matrix P of a ROS camera_info.
        image_size: width and height of the camera's images, for files without it, as a bare camera matrix, and to
            choose the camera of that size where a file has several.

    Raises:
        InputError: it holds no camera or several, its fields contradict each other, or it is no pinhole camera's.
        OSError: the file cannot be read.
    """
    file, selector = split_selector(path)
    where = str(file)
    document = _one_of_a_scene(camera_text.parse(file), file, image_size)
    fields, remarks = chosen_camera(document, selector, image_size, where)
    fields = expanded(fields, where)
    refuse_fisheye(fields, where)
    size, taken = image_size_of(fields, image_size, where)
    fields = from_angle(fields, size, where)
    matrix, source = camera_matrix(fields, where, rectified)
    matrix, shifted = counted_from_centers(matrix, fields)
    odd = require_fitting(matrix, size, taken, fields, where)
    window, cut = windowed(size, fields, where)
    if taken:
        remarks.append(f"holds no image size; that of the images, {size[0]} x {size[1]}, is taken.")
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    full = Camera.from_json(
        {"width": window.full[0], "height": window.full[1], "fx": fx, "fy": fy, "cx": cx, "cy": cy}, where
    )
    camera = window.of(full, where)
    lens = None if rectified or source == "projection" else lens_of(fields, matrix[0, 1], where)
    if lens is not None:
        lens = replace(lens, skew=lens.skew * camera.fx / full.fx)
    remarks += shifted + odd + cut + _matrix_remarks(fields, source, rectified, lens, where)
    unit = _depth_unit(fields, where, remarks)
    return CameraFile(camera, lens, tuple(f"{where}: {remark}" for remark in remarks), unit)


def distortion_warning(lens: Lens) -> str:
    """What must be done about a lens where images cannot be rectified here."""
    return (
        f"its lens distortion ({lens.describe()}) is no part of a pinhole camera: rectify the depth images to its "
        "camera matrix first, as 'posenet predict' does by itself."
    )


def _one_of_a_scene(document: Any, path: Path, size_of_images: ImageSize | None) -> Any:
    """BOP's scene_camera.json has a camera for every image: that of all, and the size of the images beside it."""
    if not isinstance(document, dict) or not document or not all(str(key).isdecimal() for key in document):
        return document
    entries = list(document.values())
    if not all(isinstance(entry, dict) and "cam_K" in entry for entry in entries):
        return document
    if any(entry["cam_K"] != entries[0]["cam_K"] for entry in entries):
        raise InputError(
            f"{path}: its images have different cameras; give 'posenet predict' the scene's folder, {path.parent}, "
            "which reads each image with its own."
        )
    camera = {k: entries[0].get(k) for k in ("cam_K", "depth_scale")}
    if size_of_images is not None:
        return camera
    from evalkit.image_file import image_size  # slow to import

    pictures = (file for kind in ("depth", "rgb", "gray") for file in sorted((path.parent / kind).glob("*.*")))
    picture = next(pictures, None)
    if picture is None:
        raise InputError(
            f"{path}: holds no image size and lies beside no images; give the dataset's BOP camera.json instead."
        )
    width, height = image_size(picture)
    return {"width": width, "height": height} | camera


def _matrix_remarks(fields: Fields, source: str, rectified: bool, lens: Lens | None, where: str) -> list[str]:
    """Which of K and P was followed, where it makes a difference, and how it is written."""
    if "projection" not in fields:
        by_columns = is_by_columns(fields, "matrix")
        remarks = ["its camera matrix is written by columns, and so it is read."] if by_columns else []
        applied = ["images count as rectified to the camera matrix, distortion is not applied."] if rectified else []
        return remarks + applied
    if source == "projection":
        turned = "rectification" in fields and not np.allclose(
            numbers(fields["rectification"], where, "R"), np.eye(3).ravel(), atol=1e-6
        )
        frame = " Poses are then in the rectified camera's frame, which R turns." if turned else ""
        return [f"the projection matrix P is followed, as by rectified images (image_rect).{frame}"]
    other = matrix_field(fields, "projection", where)
    matrix = camera_matrix(fields, where, False)[0]
    if lens is None and np.abs(other - matrix).max() <= SAME_PIXELS:
        return []
    return [
        "the camera matrix K is followed, as by images as taken (image_raw); for rectified ones (image_rect), which "
        "follow P, say --rectified."
    ]


def _depth_unit(fields: Fields, where: str, remarks: list[str]) -> float | None:
    """Meters a step by BOP's depth_scale, which counts millimeters, by ORB-SLAM's DepthMapFactor, steps a meter, or
    by a depth_unit in meters.
    """
    if "depthmapfactor" in fields and number(fields, "depthmapfactor", where) > 0:
        return 1.0 / number(fields, "depthmapfactor", where)
    if "depthunit" in fields:
        unit = number(fields, "depthunit", where)
        if UNITS[0] <= unit <= UNITS[1]:
            return unit
        remarks.append(f"its depth unit {unit:g} is not meters a step, so it is left aside; say --depth-unit.")
        return None
    if "depthscale" not in fields:
        return None
    scale = number(fields, "depthscale", where)
    if BOP_SCALES[0] <= scale <= BOP_SCALES[1]:
        return scale * 1e-3
    remarks.append(
        f"its depth_scale {scale:g} is not millimeters a step as BOP counts them and is left aside; say --depth-unit."
    )
    return None
