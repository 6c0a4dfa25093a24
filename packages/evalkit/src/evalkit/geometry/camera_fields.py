"""The fields of a camera, whatever a file calls them: one canonical name each, and no two that contradict."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry.camera_text import FORMATS, ColmapRows

LARGEST = 1e12  # no intrinsic is near it, and integers beyond 1e308 are no floats
SAME = 1e-6  # relative; two fields that differ by more contradict each other
NAMES = {
    "width": ("imagewidth", "w", "sensorwidth"),
    "height": ("imageheight", "h", "sensorheight"),
    "size": ("resolution", "imagesize", "imgsize"),
    "fx": ("fu", "flx", "focalx", "focallengthx"),
    "fy": ("fv", "fly", "focaly", "focallengthy"),
    "cx": ("cu", "ppx", "principalpointx"),
    "cy": ("cv", "ppy", "principalpointy"),
    "f": ("focal", "focallength"),
    "center": ("principalpoint",),
    "skew": ("cameraskew", "axisskew"),
    "matrix": ("cameramatrix", "k", "camk", "intrinsicmatrix", "mtx", "m1", "kmatrix", "cammatrix"),
    "projection": ("projectionmatrix", "p"),
    "rectification": ("rectificationmatrix", "r"),
    "distortion": (
        "distortioncoefficients", "distcoeffs", "dist", "d", "d1", "coeffs", "distortioncoeffs", "distcoef",
        "distortioncoefs", "distortionparameters", "distortionparams", "distcoefs",
    ),
    "model": ("distortionmodel", "modeltype", "lensmodel"), "cameramodel": ("cameratype",), "intrinsics": (),
    "fisheye": ("fisheyemodel", "isfisheye"),
    "roi": (), "binningx": (), "binningy": (), "depthscale": (), "depthmapfactor": (), "colmap": (),
}  # fmt: skip
RADIAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # in OpenCV's order
CANONICAL = {alias: name for name, aliases in NAMES.items() for alias in (name, *aliases)} | {k: k for k in RADIAL}
MAIN = {"fx", "fy", "cx", "cy", "f", "matrix", "projection", "colmap"}
WORDS = {"matrix": "camera matrix", "projection": "projection matrix"}
Fields = dict[str, Any]


def find_camera(document: Any, where: str) -> Fields:
    """The canonical fields of the one camera in a document, at its top or one level down or more.

    Raises:
        InputError: there is none, there are several, or two fields say different things.
    """
    if isinstance(document, list) and len(document) in (3, 9):
        document = {"matrix": document}  # nothing but a camera matrix
    if not isinstance(document, dict):
        raise InputError(f"{where}: holds no camera; {FORMATS}.")
    fields = canonical(document, where)
    if MAIN & set(fields):
        return fields
    inner = {str(key): value for key, value in document.items() if isinstance(value, dict) and _has_camera(value)}
    if len(inner) > 1:
        raise InputError(
            f"{where}: holds several cameras ({', '.join(list(inner)[:6])}); write the one that took the depth images "
            "to a file of its own."
        )
    if not inner:
        raise InputError(f"{where}: holds no camera; {FORMATS}.")
    nested = find_camera(next(iter(inner.values())), where)
    for name, value in fields.items():
        add_field(nested, name, value, where)
    return nested


def _has_camera(document: dict[Any, Any], depth: int = 3) -> bool:
    keys = {_name(key) for key in document}
    if MAIN & keys or any(_plain(key) == "intrinsics" and isinstance(value, list) for key, value in document.items()):
        return True
    return depth > 0 and any(_has_camera(value, depth - 1) for value in document.values() if isinstance(value, dict))


def canonical(document: dict[Any, Any], where: str) -> Fields:
    """The known fields under their canonical names; groups of fields in place of a matrix or of a list are opened.

    Raises:
        InputError: two fields that mean the same hold different values.
    """
    fields: Fields = {}
    for key, value in document.items():
        name = _name(key)
        if name is None or value is None or (name == "colmap" and not isinstance(value, ColmapRows)):
            continue
        opened = canonical(value, where) if isinstance(value, dict) and name in ("matrix", "distortion") else {}
        if name == "intrinsics" and isinstance(value, list):  # a dictionary is a group, which find_camera looks into
            opened = dict(zip(("fx", "fy", "cx", "cy"), value, strict=True)) if len(value) == 4 else {"matrix": value}
        if _plain(key) == "intrinsicmatrix":
            value = _by_rows(value)
        for inner, found in (opened or {name: value}).items():
            if inner != "intrinsics":
                add_field(fields, inner, found, where)
    return fields


def _by_rows(value: Any) -> Any:
    """Open3D writes its intrinsic_matrix by columns, others by rows: the zeros tell."""
    if isinstance(value, list) and len(value) == 9 and value[2] == value[5] == 0 != value[6]:
        return [value[i] for i in (0, 3, 6, 1, 4, 7, 2, 5, 8)]
    return value


def add_field(fields: Fields, name: str, value: Any, where: str) -> None:
    """Note what a field says.

    Raises:
        InputError: another one said something else of the same thing.
    """
    if name in fields and not _agree(fields[name], value):
        raise InputError(
            f"{where}: two fields give different values for the {WORDS.get(name, name)}; keep the one that is right."
        )
    fields.setdefault(name, value)


def _agree(first: Any, second: Any) -> bool:
    if first == second:
        return True
    try:
        a, b = (numbers([value] if isinstance(value, int | float) else value, "", "") for value in (first, second))
    except InputError:
        return False
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=SAME, atol=SAME))


def _name(key: Any) -> str | None:
    """The canonical name of a field; ORB-SLAM writes Camera.fx and Camera1.fx."""
    plain = _plain(key)
    return CANONICAL.get(plain) or CANONICAL.get(re.sub("^camera1?", "", plain))


def _plain(key: Any) -> str:
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
    """A list of finite numbers, flat or in rows, or ``{"data": [...]}`` as OpenCV and ROS write matrices.

    Raises:
        InputError: it is none.
    """
    values = value.get("data") if isinstance(value, dict) else value
    flat = (
        [n for row in values for n in (row if isinstance(row, list) else [row])] if isinstance(values, list) else None
    )
    if flat is None or not all(
        isinstance(n, int | float) and not isinstance(n, bool) and abs(n) < LARGEST for n in flat
    ):
        raise InputError(f"{where}: '{name}' must be a list of finite numbers, or have one as its 'data'.")
    return np.array(flat, float)
