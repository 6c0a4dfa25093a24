"""The fields of a camera, whatever a file calls them: one canonical name each, and no two that contradict."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError

LARGEST = 1e12  # no intrinsic is near it, and integers beyond 1e308 are no floats
SAME = 1e-6  # relative; two fields that differ by more contradict each other
NAMES = {
    "width": ("imagewidth", "w", "resx", "resolutionx", "resolutionwidth"),
    "height": ("imageheight", "h", "resy", "resolutiony", "resolutionheight"),
    "size": ("resolution", "imagesize", "imgsize", "imageresolution"),
    "fx": ("fu", "flx", "focalx", "focallengthx"),
    "fy": ("fv", "fly", "focaly", "focallengthy"),
    "cx": ("cu", "ppx", "principalpointx", "u0", "mx"),
    "cy": ("cv", "ppy", "principalpointy", "v0", "my"),
    "f": ("focal", "focallength"),
    "center": ("principalpoint",),
    "anglex": ("cameraanglex",),
    "skew": ("cameraskew", "axisskew"),
    "matrix": (
        "cameramatrix", "k", "camk", "intrinsicmatrix", "mtx", "kmatrix", "cammatrix", "intrinsic", "cameraintrinsic",
        "cameraintrinsics", "intrinsicparameters", "camera",
    ),
    "projection": ("projectionmatrix", "p"),
    "rectification": ("rectificationmatrix", "r"),
    "distortion": (
        "distortioncoefficients", "distcoeffs", "dist", "d", "coeffs", "distortioncoeffs", "distcoef", "distcoeff",
        "distort", "distortioncoefs", "distortioncoeff", "distortionparameters", "distortionparams", "distcoefs",
        "disto",
    ),
    "radial": ("radialdistortion",), "tangential": ("tangentialdistortion",),
    "model": ("distortionmodel", "modeltype", "lensmodel"), "cameramodel": ("cameratype",), "intrinsics": (),
    "fisheye": ("fisheyemodel", "isfisheye"),
    "roi": (), "binningx": (), "binningy": (), "depthscale": (),
    "depthmapfactor": ("rgbddepthmapfactor", "factordepth"),
    "depthunit": ("depthunits",), "colmap": (),
}  # fmt: skip
RADIAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # in OpenCV's order
CANONICAL = {alias: name for name, aliases in NAMES.items() for alias in (name, *aliases)} | {k: k for k in RADIAL}
MAIN = {"fx", "fy", "cx", "cy", "f", "matrix", "projection", "colmap", "anglex"}
GROUPS = ("matrix", "distortion")  # fields in whose place a group of fields may stand
BENDS = re.compile(r"distort|dist(coef|param)|^(codx|cody|xi|taux|tauy)$")  # names of what else a lens does
HARMLESS = re.compile(r"^un|^is|center|model|type|limit|radius|file|map|error|name|enabled")
ALSO_WORDS = ("camera", "intrinsic", "cameraintrinsic", "cameraintrinsics")  # names of cameras too, not only matrices
FROM_CORNER = ("flx", "fly")  # nerfstudio's names; it counts pixels from the corner of the first, as COLMAP does
MATLAB = {"RadialDistortion", "TangentialDistortion", "ImageSize"}  # of a cameraParameters object
WORDS = {"matrix": "camera matrix", "projection": "projection matrix"}
Fields = dict[str, Any]


def canonical(document: dict[Any, Any], where: str) -> Fields:
    """The known fields under their canonical names; groups of fields in place of a matrix or of a list are opened.

    Raises:
        InputError: two fields that mean the same hold different values, or a distortion has a name not known.
    """
    fields: Fields = {"dialect": "matlab"} if set(map(str, document)) >= MATLAB else {}
    for key, value in document.items():
        name = known_name(key)
        if value is None or (name is None and not _is_unknown_distortion(key, value)):
            continue
        if plain(key) in ALSO_WORDS and not isinstance(value, dict | list):
            continue
        if name is None:
            raise InputError(
                f"{where}: its field '{key}' bends the image in a way that is not known here; rectify the depth "
                "images, and give the pinhole camera that they were rectified to."
            )
        opened = canonical(value, where) if isinstance(value, dict) and name in GROUPS else {}
        if name == "intrinsics" and (numbers_only := from_numbers(value)) is not None:  # else a group
            opened = numbers_only
        if plain(key) in FROM_CORNER:
            fields["dialect"] = "corner"
        for inner, found in (opened or {name: value}).items():
            if inner not in ("intrinsics", "dialect", "colmap"):
                add_field(fields, inner, found, where)
    return fields


def _is_unknown_distortion(key: Any, value: Any) -> bool:
    name = plain(key)
    return bool(BENDS.search(name)) and not HARMLESS.search(name) and _has_numbers(value)


def _has_numbers(value: Any) -> bool:
    """Whether a value is a number other than 0, or holds one."""
    if isinstance(value, dict | list):
        return any(_has_numbers(item) for item in (value.values() if isinstance(value, dict) else value))
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) > 0


def from_numbers(value: Any) -> Fields | None:
    """What numbers alone say: a camera matrix, or fx fy cx cy, with width and height before or after; else None."""
    if isinstance(value, dict):
        return None
    try:
        found = numbers(value, "", "")
    except InputError:
        return None
    rows = len(value) if value and isinstance(value[0], list) else 1
    if len(found) in (9, 12, 16) and rows in (1, 3, 4):
        return {"projection" if len(found) == 12 else "matrix": value}
    if len(found) == 4 and rows in (1, 4):
        return dict(zip(("fx", "fy", "cx", "cy"), found.tolist(), strict=True))
    if len(found) == 6 and rows in (1, 3):
        sized, rest = (found[:2], found[2:]) if _is_size(found[:2], found[4:]) else (found[4:], found[:4])
        if _is_size(sized, rest[2:]):
            size = dict(zip(("width", "height"), map(int, sized), strict=True))
            return size | dict(zip(("fx", "fy", "cx", "cy"), rest.tolist(), strict=True))
    return None


def _is_size(size: NDArray[np.float64], center: NDArray[np.float64]) -> bool:
    """Whether two whole numbers are the size of an image with this center."""
    return bool((size == np.round(size)).all() and (size > 0).all() and (np.abs(center / size - 0.5) < 0.25).all())


def add_field(fields: Fields, name: str, value: Any, where: str) -> None:
    """Note what a field says.

    Raises:
        InputError: another one said something else of the same thing.
    """
    if name in fields and not agree(fields[name], value):
        raise InputError(
            f"{where}: two fields give different values for the {WORDS.get(name, name)}; keep the one that is right."
        )
    fields.setdefault(name, value)


def agree(first: Any, second: Any) -> bool:
    """Whether two values of a field say the same."""
    if first == second:
        return True
    try:
        a, b = (numbers([value] if isinstance(value, int | float) else value, "", "") for value in (first, second))
    except InputError:
        return False
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=SAME, atol=SAME))


def known_name(key: Any) -> str | None:
    """The canonical name of a field; ORB-SLAM writes Camera.fx and Camera1.fx."""
    name = plain(key)
    return CANONICAL.get(name) or CANONICAL.get(re.sub("^camera1?", "", name))


def plain(key: Any) -> str:
    return re.sub("[-_. ]", "", str(key).lower())


def number(fields: Fields, name: str, where: str) -> float:
    """One finite number.

    Raises:
        InputError: the field is missing, a text, or no number.
    """
    value = fields.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST:
        found = f"{value!r}"[:40]
        raise InputError(
            f"{where}: the field '{name}' is missing; add it, in pixels."
            if value is None
            else f"{where}: the field '{name}' must be a number, found {found}; write it without quotes or units."
        )
    return float(value)


def numbers(value: Any, where: str, name: str) -> NDArray[np.float64]:
    """A list of finite numbers, flat or in rows, or a group that has it as its 'data' or by index ("0", "1", …).

    Raises:
        InputError: it is none.
    """
    values = value.get("data", _by_index(value)) if isinstance(value, dict) else value
    flat = (
        [n for row in values for n in (row if isinstance(row, list) else [row])] if isinstance(values, list) else None
    )
    if flat is None or not all(
        isinstance(n, int | float) and not isinstance(n, bool) and abs(n) < LARGEST for n in flat
    ):
        raise InputError(f"{where}: '{name}' must be a list of finite numbers, or have one as its 'data'.")
    return np.array(flat, float)


def _by_index(group: dict[Any, Any]) -> list[Any] | None:
    """A list that JavaScript wrote as a group, as its typed arrays are."""
    return list(group.values()) if [str(key) for key in group] == [str(i) for i in range(len(group))] else None
