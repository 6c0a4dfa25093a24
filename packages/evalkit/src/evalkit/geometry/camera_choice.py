"""Which camera a file speaks of: all that it holds, by name, and the one that took the images."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from evalkit.errors import InputError
from evalkit.geometry.camera_fields import MAIN, Fields, add_field, agree, canonical, from_numbers, known_name, plain
from evalkit.geometry.camera_lines import ColmapRows, number_of
from evalkit.geometry.camera_size import expanded
from evalkit.geometry.camera_text import FORMATS

STREAMS = ("depth", "color", "colour", "rgb", "infrared", "ir", "left", "right", "1", "2")
PAIRED = {"projection", "matrix", "distortion", "rectification"}  # what stereo calibrations have for each of 1 and 2
RECTIFIED = re.compile(r"rectified\.(\d+)\.(\w+)")  # RealSense's calibration, the depth stream at each resolution
LABELS = ("name", "camera_name", "id", "Id", "serial", "label", "SensorType")
OUTER = "outer"  # the name of a camera that the document itself is
MOST_LISTED = 8
Named = tuple[str, Fields]
ImageSize = Callable[[], tuple[int, int]]  # width and height, looked up only where they are needed


def split_selector(path: Path | str) -> tuple[Path, str]:
    """``FILE#NAME`` as the file and the camera's name in it, which is empty where none is said."""
    if Path(path).exists() or "#" not in str(path):
        return Path(path), ""
    file, _, name = str(path).rpartition("#")
    return Path(file), name


def chosen_camera(document: Any, selector: str, image_size: ImageSize | None, where: str) -> tuple[Fields, list[str]]:
    """The canonical fields of the camera that took the images, and a remark where it is one of several.

    Args:
        selector: a part of its name; empty: whichever there is.
        image_size: of the images; of several cameras the only one of this size is taken.

    Raises:
        InputError: there is no such camera, or it cannot be known which of several it is.
    """
    found = _distinct(list(_cameras(document, "", where)))
    if not found:
        raise InputError(f"{where}: holds no camera; {FORMATS}.")
    named = [camera for camera in found if selector and camera[0].lower() == selector.lower()]
    named = named or [camera for camera in found if selector.lower() in camera[0].lower()]
    if not named:
        raise InputError(f"{where}: holds no camera '{selector}', but {_listed(found)}.")
    fitting = named
    if len(named) > 1 and image_size is not None:
        size = image_size()
        sizes = [_size_of(camera, where) for camera in named]
        fitting = [camera for camera, its in zip(named, sizes, strict=True) if its == size]
        fitting = fitting or [camera for camera, its in zip(named, sizes, strict=True) if its is None]
        if not fitting:
            raise InputError(
                f"{where}: none of its cameras ({_listed(named)}) is of the images' {size[0]} x {size[1]} pixels; give "
                "the camera that took them."
            )
    if len(fitting) > 1:
        example = next((name for name, _ in fitting if "depth" in name.lower()), fitting[0][0])
        raise InputError(
            f"{where}: holds several cameras ({_listed(fitting)}); say which one took the depth images, as in "
            f"{Path(where).name}#{example} (for depth aligned to color, the color camera)."
        )
    name, fields = fitting[0]
    return fields, [f"its camera '{name}' is taken, of {_listed(found)}."] if len(found) > 1 else []


def _cameras(node: Any, name: str, where: str) -> Iterator[Named]:
    """Every camera in a document under the path that leads to it, with the fields that stand around it."""
    numbers = from_numbers(node) if not name or "intrinsic" in plain(name) else None
    if numbers is not None:
        yield name, numbers
        return
    if isinstance(node, ColmapRows):
        yield from ((number, {"colmap": row}) for number, row in node.items())
        return
    node = _by_stream(node) if isinstance(node, dict) else node
    fields = canonical(node, where) if isinstance(node, dict) else {}
    if MAIN & set(fields):
        yield name or OUTER, dict(fields)
        fields = {}
    for key, child in _inner(node, where):
        for label, camera in _cameras(child, f"{name}/{key}".lstrip("/"), where):
            for field, value in fields.items():
                add_field(camera, field, value, where)
            yield label, camera


def _inner(node: Any, where: str) -> Iterator[tuple[str, Any]]:
    """What may hold cameras below a node: groups, lists of groups, DepthAI's pairs of a number and a group."""
    for key, value in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        if isinstance(node, list) and isinstance(value, list) and len(value) == 2 and isinstance(value[1], dict):
            yield str(value[0]), value[1]
        elif isinstance(node, list) and isinstance(value, dict):
            yield next((str(value[label]) for label in LABELS if label in value), str(key)), value
        elif isinstance(node, dict) and _may_hold(key, value, where):
            yield str(key), value


def _may_hold(key: Any, value: Any, where: str) -> bool:
    """Whether a field of no camera yet holds some; those of the camera itself were read with it."""
    known = known_name(key)
    if isinstance(value, dict):
        return known in (None, "intrinsics") or (known == "matrix" and not MAIN & set(canonical(value, where)))
    if not isinstance(value, list) or known not in (None, "matrix"):
        return False
    return (
        any(isinstance(item, dict) for item in value)
        or any(isinstance(item, list) and len(item) == 2 and isinstance(item[1], dict) for item in value)
        or (known is None and "intrinsic" in plain(key) and from_numbers(value) is not None)
    )


def _by_stream(node: dict[Any, Any]) -> dict[Any, Any]:
    """Flat fields that name their camera, such as depth_fx, fx_color or M1, as groups of such fields."""
    found: dict[Any, Any] = {}
    for key, value in node.items():
        rectified = RECTIFIED.fullmatch(str(key))
        stream, field = (f"rectified {rectified[1]}", rectified[2]) if rectified else _stream_of(key, value)
        if not stream:
            found[key] = value
            continue
        group = found.setdefault(stream, {})
        if not isinstance(group, dict):
            return node
        group[field] = number_of(value) if rectified and isinstance(value, str) else value
    return {
        key: value
        for key, value in found.items()
        if not (str(key).startswith("rectified ") and not (value.get("width") and value.get("height")))
    }


def _stream_of(key: Any, value: Any) -> tuple[str, str]:
    """The stream that a flat field is of, and its name without it; both empty where it names none."""
    name, is_matrix = plain(key), isinstance(value, list | dict)
    if known_name(key) is not None and not (name in ("m1", "d1", "p1", "p2", "k1", "k2") and is_matrix):
        return "", ""
    for stream in STREAMS:
        for field in (name.removesuffix(stream), name.removeprefix(stream)):
            known = known_name(field) if field != name else None
            if known is None or known == "intrinsics" or (stream.isdecimal() and not (known in PAIRED and is_matrix)):
                continue
            return stream, field
    if name in ("m1", "m2") and is_matrix:
        return name[1], "matrix"
    return "", ""


def _distinct(cameras: list[Named]) -> list[Named]:
    """The cameras without those that say the same as one before."""
    found: list[Named] = []
    for name, fields in cameras:
        if not any(_same(fields, other) for _, other in found):
            found.append((name, fields))
    return found


def _same(fields: Fields, other: Fields) -> bool:
    return fields.keys() == other.keys() and all(agree(value, other[name]) for name, value in fields.items())


def _size_of(camera: Named, where: str) -> tuple[Any, Any] | None:
    """Width and height by a camera's fields or, where these do not say them, by its name, as in 640x480."""
    name, fields = camera
    try:
        full = expanded(dict(fields), where)
    except InputError:
        return None
    if {"width", "height"} <= set(full):
        return full["width"], full["height"]
    said = re.search(r"(\d{2,5})\s?[x*]\s?(\d{2,5})", name)
    return (int(said[1]), int(said[2])) if said else None


def _listed(cameras: list[Named]) -> str:
    names = []
    for camera in cameras[:MOST_LISTED]:
        name, size = camera[0], _size_of(camera, "")
        of = f" of {size[0]} x {size[1]}" if size and f"{size[0]}x{size[1]}" not in name else ""
        names.append(f"'{name}'{of}")
    more = len(cameras) - MOST_LISTED
    return ", ".join(names) + (f" and {more} more" if more > 0 else "")
