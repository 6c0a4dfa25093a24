"""Cameras as other people's files describe them: the pinhole camera, the lens before it, and what was chosen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry import camera_text
from evalkit.geometry.camera import Camera
from evalkit.geometry.camera_fields import RADIAL, Fields, add_field, find_camera, number, numbers
from evalkit.geometry.camera_matrix import NEGLIGIBLE, SAME_PIXELS, camera_matrix, matrix_field
from evalkit.geometry.camera_window import windowed
from evalkit.geometry.lens import Lens

SIZES = {"width", "height", "roi", "binningx", "binningy"}  # fields that say a size, or need one to mean anything
FISHEYES = ("equidistant", "fisheye", "kannala", "omni", "mei", "unified", "ftheta", "f-theta", "eucm", "ds")
KNOWN_LENSES = (
    "plumb_bob", "rational_polynomial", "brown", "radtan", "none", "pinhole", "opencv", "perspective", "radial", "",
)  # fmt: skip
REALSENSE = {0: "none", 1: "modified_brown_conrady", 2: "inverse_brown_conrady", 3: "ftheta", 4: "brown_conrady"}
SAME_COEFFICIENT = 1e-6
FARTHEST_OFF = 0.25  # of the image's sides, from its middle to the principal point, that nobody's camera exceeds
BOP_SCALES = (0.01, 10.0)  # millimeters a step; a depth_scale beyond is of another convention
# COLMAP's parameters by camera model, in the order in which cameras.txt has them
COLMAP = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"), "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"), "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}  # fmt: skip


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


ImageSize = Callable[[], tuple[int, int]]  # width and height, looked up only where a file does not say them


def read_camera(path: Path | str, rectified: bool = False, image_size: ImageSize | None = None) -> CameraFile:
    """Read a camera of ours, BOP, ROS, OpenCV, RealSense, Open3D, Zivid, Kalibr, nerfstudio, COLMAP or Siléane.

    Args:
        rectified: the images were rectified; they then follow the projection matrix P of a ROS camera_info.
        image_size: of the camera's images, for files without it, as a bare camera matrix.

    Raises:
        InputError: it is none of these, its fields contradict each other, or it is no pinhole camera's.
        OSError: the file cannot be read.
    """
    where = str(path)
    fields = _expanded(find_camera(_one_of_a_scene(camera_text.parse(Path(path)), Path(path)), where), where)
    _refuse_fisheye(fields, where)
    matrix, source = camera_matrix(fields, where, rectified)
    sizeless = image_size is not None and not SIZES & set(fields)
    size = _size_of_images(image_size(), matrix, where) if image_size and sizeless else _size(fields, where)
    window, remarks = windowed(size, fields, where)
    if sizeless:
        remarks = [f"holds no image size; that of the images, {size[0]} x {size[1]}, is taken.", *remarks]
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    full = Camera.from_json(
        {"width": window.full[0], "height": window.full[1], "fx": fx, "fy": fy, "cx": cx, "cy": cy}, where
    )
    camera = window.of(full, where)
    lens = None if rectified or source == "projection" else _lens(fields, matrix[0, 1], where)
    if lens is not None:
        lens = replace(lens, skew=lens.skew * camera.fx / full.fx)
    remarks = [f"{where}: {remark}" for remark in [*remarks, *_matrix_remarks(fields, source, rectified, lens, where)]]
    unit = _depth_unit(fields, where, remarks)
    return CameraFile(camera, lens, tuple(remarks), unit)


def distortion_warning(lens: Lens) -> str:
    """What must be done about a lens where images cannot be rectified here."""
    return (
        f"its lens distortion ({lens.describe()}) is no part of a pinhole camera: rectify the depth images to its "
        "camera matrix first, as 'posenet predict' does by itself."
    )


def _one_of_a_scene(document: Any, path: Path) -> Any:
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
    from evalkit.image_file import image_size  # slow to import

    pictures = (file for kind in ("depth", "rgb", "gray") for file in sorted((path.parent / kind).glob("*.*")))
    picture = next(pictures, None)
    if picture is None:
        raise InputError(
            f"{path}: holds no image size and lies beside no images; give the dataset's BOP camera.json instead."
        )
    width, height = image_size(picture)
    return {"width": width, "height": height} | {k: entries[0].get(k) for k in ("cam_K", "depth_scale")}


def _expanded(fields: Fields, where: str) -> Fields:
    """Fields that stand for several: COLMAP's row, one focal length, a size, a principal point."""
    if "colmap" in fields:
        return _colmap(fields["colmap"], where)
    fields = dict(fields)
    for name, parts in (("f", ("fx", "fy")), ("size", ("width", "height")), ("center", ("cx", "cy"))):
        if name not in fields:
            continue
        value = fields.pop(name)
        if not isinstance(value, list) or len(value) != 2:
            value = [value, value] if name == "f" and not isinstance(value, list) else None
        if value is None:
            raise InputError(f"{where}: the field '{name}' must hold two numbers.")
        for part, found in zip(parts, value, strict=True):
            add_field(fields, part, found, where)
    return fields


def _colmap(rows: list[list[Any]], where: str) -> Fields:
    if len({tuple(row[1:]) for row in rows}) != 1:
        raise InputError(f"{where}: holds {len(rows)} cameras; leave the line of the one that took the depth images.")
    _, model, width, height, *values = rows[0]
    names = COLMAP.get(model)
    if names is None or len(names) != len(values):
        raise InputError(
            f"{where}: the camera model {model} with {len(values)} parameters is not read; known are "
            f"{', '.join(COLMAP)}; undistort the images, and give the pinhole camera of the result."
        )
    fields: Fields = dict(zip(names, values, strict=True)) | {"width": width, "height": height}
    for axis in ("cx", "cy"):
        fields[axis] = number(fields, axis, where) - 0.5  # COLMAP counts from the corner of the first pixel
    return _expanded(fields, where)


def _size(fields: Fields, where: str) -> tuple[int, int]:
    sides = []
    for side in ("width", "height"):
        if side not in fields:
            raise InputError(
                f"{where}: holds a camera but no image size; add image_{side}, in pixels, or write width, height, fx, "
                "fy, cx, cy as JSON."
            )
        value = number(fields, side, where)
        if value != int(value):
            raise InputError(f"{where}: '{side}' must be a whole number of pixels.")
        sides.append(int(value))
    return sides[0], sides[1]


def _size_of_images(size: tuple[int, int], matrix: NDArray[np.float64], where: str) -> tuple[int, int]:
    """The size that images have, if a camera of this matrix (3, 3) may have taken them.

    Raises:
        InputError: the principal point is far from their middle, so that it was calibrated for images of another size.
    """
    off = np.abs(matrix[:2, 2] - (np.array(size) - 1) / 2) / size
    if off.max() > FARTHEST_OFF:
        raise InputError(
            f"{where}: its principal point ({matrix[0, 2]:g}, {matrix[1, 2]:g}) is far from the middle of images of "
            f"{size[0]} x {size[1]} pixels, so it is of another size; give the camera matrix of this one."
        )
    return size


def _refuse_fisheye(fields: Fields, where: str) -> None:
    """A fisheye's matrix is not a pinhole's, not even where all its coefficients are zero."""
    model = " ".join(name for name in (_model(fields), str(fields.get("cameramodel", "")).lower()) if name)
    is_fisheye = any(name in model if len(name) > 3 else name in model.split() for name in FISHEYES)
    if is_fisheye or fields.get("fisheye") not in (None, 0, False):
        said = fields.get("model") or fields.get("cameramodel") or "fisheye"
        raise InputError(
            f"{where}: its distortion_model is '{said}', of a fisheye lens, but cameras are pinholes here; rectify the "
            "depth images, and give the pinhole camera that they were rectified to."
        )


def _model(fields: Fields) -> str:
    """The lens model's name in lower case; RealSense writes numbers too."""
    model = fields.get("model", "")
    if isinstance(model, int):
        return REALSENSE.get(model, str(model))
    return str(model).lower().removeprefix("distortion.").replace(" ", "_").replace("-", "_")


def _lens(fields: Fields, skew: float, where: str) -> Lens | None:
    """The lens, None where it changes nothing."""
    if "distortion" in fields:
        coefficients = tuple(numbers(fields["distortion"], where, "distortion_coefficients").tolist())
        for place, name in enumerate(RADIAL):
            listed = coefficients[place] if place < len(coefficients) else 0.0
            if name in fields and abs(number(fields, name, where) - listed) > SAME_COEFFICIENT:
                raise InputError(
                    f"{where}: '{name}' is {fields[name]:g}, but {listed:g} in the list of distortion coefficients; "
                    "keep the one that is right."
                )
    else:
        coefficients = tuple(number(fields, k, where) if k in fields else 0.0 for k in RADIAL)
    if not any(abs(c) > NEGLIGIBLE for c in coefficients):
        coefficients = ()
    if not coefficients and not abs(skew) > NEGLIGIBLE * max(1.0, abs(skew)):
        return None
    model = _model(fields)
    if coefficients and not any(name in model for name in KNOWN_LENSES if name) and model:
        raise InputError(
            f"{where}: its distortion_model '{fields['model']}' is not known; rectify the depth images, and give the "
            "pinhole camera that they were rectified to."
        )
    try:
        return Lens(coefficients, skew, inverse="inverse" in model, radial_first="modified" in model)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _matrix_remarks(fields: Fields, source: str, rectified: bool, lens: Lens | None, where: str) -> list[str]:
    """Which of K and P was followed, where it makes a difference."""
    if "projection" not in fields:
        return [] if not rectified else ["images count as rectified to the camera matrix, distortion is not applied."]
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
    """Meters a step by BOP's depth_scale, which counts millimeters, or ORB-SLAM's DepthMapFactor, steps a meter."""
    if "depthmapfactor" in fields and number(fields, "depthmapfactor", where) > 0:
        return 1.0 / number(fields, "depthmapfactor", where)
    if "depthscale" not in fields:
        return None
    scale = number(fields, "depthscale", where)
    if BOP_SCALES[0] <= scale <= BOP_SCALES[1]:
        return scale * 1e-3
    remarks.append(
        f"{where}: its depth_scale {scale:g} is not millimeters a step as BOP counts them, so it is left aside; say "
        "--depth-unit."
    )
    return None
