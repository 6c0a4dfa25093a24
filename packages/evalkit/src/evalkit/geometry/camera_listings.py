"""Cameras as programs print them: RealSense's rs-enumerate-devices -c and pyrealsense2, and HALCON's camera files."""

from __future__ import annotations

import re
from typing import Any

from evalkit.geometry.camera_lines import number_of

HEADER = re.compile(r'Intrinsics? of "([^"]+)"[\s/]*(\d+x\d+)')  # … / {Z16}
PRINTED = re.compile(  # pyrealsense2's intrinsics, as str() writes them
    r"\[?\s*(\d+)x(\d+)\s+p\[([^\]]+)\]\s+f\[([^\]]+)\]\s+([A-Za-z_ ]+?)\s*\[([^\]]*)\]"
)
NAMED = re.compile(
    r"width: ?(\d+), height: ?(\d+), ppx: ?(\S+), ppy: ?(\S+), fx: ?(\S+), fy: ?(\S+), "
    r"model: ?([^,]+), coeffs: ?\[([^\]]*)\]"
)


def is_realsense(text: str) -> bool:
    return any(pattern.search(text) for pattern in (HEADER, PRINTED, NAMED))


def read_realsense(text: str) -> dict[str, Any]:
    """The cameras in the text by stream and size, such as 'Depth 640x480'.

    Raises:
        ValueError: it is cut off.
    """
    cameras: dict[str, Any] = {}
    headers = list(HEADER.finditer(text))
    for header, after in zip(headers, [*headers[1:], None], strict=False):
        block = text[header.end() : after.start() if after else None].split("Extrinsic")[0]
        cameras[_new(cameras, f"{header[1]} {header[2]}")] = _block(block)
    for width, height, center, focal, model, coefficients in PRINTED.findall(text):
        ppx, ppy, fx, fy = (number_of(word) for word in (*center.split(), *focal.split()))
        cameras[_new(cameras, f"{width}x{height}")] = _camera(width, height, ppx, ppy, fx, fy, model, coefficients)
    for width, height, ppx, ppy, fx, fy, model, coefficients in NAMED.findall(text):
        cameras[_new(cameras, f"{width}x{height}")] = _camera(width, height, ppx, ppy, fx, fy, model, coefficients)
    return cameras


def _camera(width: Any, height: Any, ppx: Any, ppy: Any, fx: Any, fy: Any, model: str, coefficients: str) -> Any:
    names = {"width": width, "height": height, "ppx": ppx, "ppy": ppy, "fx": fx, "fy": fy}
    camera: dict[str, Any] = {name: number_of(str(value)) for name, value in names.items()}
    return camera | {
        "model": model.strip(),
        "coeffs": [number_of(word) for word in re.split(r"[\s,]+", coefficients) if word],
    }


def _block(text: str) -> dict[str, Any]:
    entries = dict(re.findall(r"^[ \t]*([A-Za-z ()]+?):[ \t]*(.+?)[ \t\r]*$", text, re.MULTILINE))
    missing = {"Width", "Height", "PPX", "PPY", "Fx", "Fy"} - set(entries)
    if missing:
        raise ValueError(f"a stream lacks {', '.join(sorted(missing))}")
    width, height, ppx, ppy, fx, fy = (entries[name] for name in ("Width", "Height", "PPX", "PPY", "Fx", "Fy"))
    model, coefficients = entries.get("Distortion", "None"), entries.get("Coeffs", "")
    return _camera(width, height, ppx, ppy, fx, fy, model, coefficients)


def _new(cameras: dict[str, Any], name: str) -> str:
    """The name, with a number where another camera has it."""
    return name if name not in cameras else f"{name} ({1 + sum(known.startswith(name) for known in cameras)})"


def is_halcon(text: str) -> bool:
    return "ParGroup: Cam" in text


def read_halcon(text: str) -> dict[str, Any]:
    """HALCON's internal camera parameters: focal length and pixels in meters, pixels counted from their centers.

    Raises:
        ValueError: it is a camera without perspective, or with distortion, whose models are HALCON's own.
    """
    entries = {name: number_of(value) for name, value in re.findall(r"^(\w+):\w+:\s*([^;\s]+)\s*;", text, re.MULTILINE)}
    numbers = {name: value for name, value in entries.items() if not isinstance(value, str)}
    width = numbers.get("ImageWidth", numbers.get("ImgWidth"))
    height = numbers.get("ImageHeight", numbers.get("ImgHeight"))
    focus, cell = numbers.get("Focus", 0), [numbers.get(axis, 0) for axis in ("Sx", "Sy")]
    if not focus or not all(cell):
        raise ValueError("it lacks Focus, Sx or Sy, as of a camera without perspective")
    bent = [name for name in ("Kappa", "K1", "K2", "K3", "P1", "P2", "Poly1", "Poly2") if numbers.get(name)]
    if bent:
        raise ValueError(
            f"its distortion {bent[0]} = {numbers[bent[0]]:g} is HALCON's own; rectify the images there with "
            "change_radial_distortion_image, and give the camera parameters of the result"
        )
    return {
        "width": width,
        "height": height,
        "fx": focus / cell[0],
        "fy": focus / cell[1],
        "cx": numbers.get("Cx"),
        "cy": numbers.get("Cy"),
    }
