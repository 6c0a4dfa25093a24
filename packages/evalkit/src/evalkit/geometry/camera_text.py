"""A camera file as a document, recognized by its content: JSON, YAML, OpenCV's FileStorage, text, NPY, NPZ."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from zipfile import BadZipFile

import numpy as np
import yaml

from evalkit.errors import InputError
from evalkit.geometry.camera_lines import number_of, read_lines
from evalkit.geometry.camera_listings import is_halcon, is_realsense, read_halcon, read_realsense

FORMATS = (
    "give width, height, fx, fy, cx, cy as JSON, a BOP camera.json, a ROS camera_info, OpenCV's calibration file, or "
    "what RealSense, Orbbec, Open3D, Zivid, Kalibr, COLMAP or Siléane write"
)
NPY, NPZ = b"\x93NUMPY", b"PK\x03\x04"
UTF_16 = (b"\xff\xfe", b"\xfe\xff")  # as Windows' PowerShell writes what a command prints
LARGEST_FILE = 1 << 20  # bytes; such files hold a few hundred
LARGEST_JSON = 32 << 20  # with a camera for each of thousands of images
# What holds no camera of depth images: a mark in the text, and what to give instead.
USELESS = {
    "CalibrationInformation": "is an Azure Kinect's factory calibration, in shares of its sensors' sizes; give the "
    "calibration of the depth mode that took the images, as its SDK or its ROS camera_info says it",
    "[LEFT_CAM_": "is a ZED's factory calibration of its raw images, and its depth follows the rectified camera; give "
    "that one, as its SDK or its ROS camera_info says it",
    "param-depthunits": "holds a RealSense's settings and no intrinsics; give what 'rs-enumerate-devices -c' prints",
    "%time,field.": "is a topic printed as a table; print it as YAML: rostopic echo -n 1 TOPIC > camera.yaml",
}


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """YAML as OpenCV, Python and ROS write it: tagged matrices and tuples, 1e-05; no field may stand twice."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        return _unique([(self.construct_object(key, deep=True), self.construct_object(value, deep=True))
                        for key, value in node.value])  # fmt: skip


def _whole_mapping(loader: _Loader, node: Any) -> dict[Any, Any]:
    return loader.construct_mapping(node)


_Loader.add_constructor("tag:yaml.org,2002:map", _whole_mapping)
_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _whole_mapping)
_Loader.add_constructor("tag:yaml.org,2002:python/tuple", lambda loader, node: loader.construct_sequence(node, True))
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def _unique(pairs: list[tuple[Any, Any]]) -> dict[Any, Any]:
    """Pairs as a dictionary.

    Raises:
        ValueError: a field stands twice; all readers of these formats would take one of them in silence.
    """
    found: dict[Any, Any] = {}
    for key, value in pairs:
        if isinstance(key, list | dict):
            raise ValueError("a list is the name of a field")
        if key in found and found[key] != value:
            raise ValueError(f"the field '{key}' stands twice, with different values")
        found[key] = value
    return found


def parse(path: Path) -> Any:
    """The document in a camera file, recognized by its content, not by its name.

    Raises:
        InputError: the file is too large, or is none of these formats.
        OSError: it cannot be read.
    """
    with open(path, "rb") as file:
        raw = file.read(LARGEST_JSON + 1)
    if len(raw) > (LARGEST_JSON if raw.lstrip()[:1] == b"{" else LARGEST_FILE):
        raise InputError(f"{path}: too large for a camera file; {FORMATS}.")
    kind = "camera"
    try:
        if raw.startswith((NPY, NPZ)):
            return _arrays(raw)
        text = raw.decode("utf-16" if raw.startswith(UTF_16) else "utf-8-sig")
        for mark, what in USELESS.items():
            if mark in text:
                raise InputError(f"{path}: {what}.")
        kind, read = _reader(text.lstrip(), path.suffix.lower())
        return read(text)
    except yaml.MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f" in line {error.problem_mark.line + 1}"
        raise InputError(f"{path}: not a YAML file ({error.problem or error.context}{line}); {FORMATS}.") from None
    except (ValueError, RecursionError, yaml.YAMLError, ElementTree.ParseError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{path}: not a {kind} file ({reason}); {FORMATS}.") from None


def _reader(text: str, suffix: str) -> tuple[str, Callable[[str], Any]]:
    """What kind of text it is, and the function that reads it."""
    if text.startswith("<"):
        return "XML", _xml
    if is_realsense(text):
        return "RealSense", read_realsense
    if is_halcon(text):
        return "HALCON", read_halcon
    if suffix == ".json" or (text.startswith("{") and suffix not in (".yaml", ".yml")):
        return "JSON", lambda text: json.loads(text, object_pairs_hook=_unique)
    if suffix in (".yaml", ".yml") or text.startswith(("%YAML", "---", "{")):
        return "YAML", _yaml
    return "camera", _text


def _text(text: str) -> Any:
    """A topic or YAML in a file of any name, else lines of words and numbers."""
    try:
        document = _yaml(text)
    except yaml.YAMLError:
        document = None
    is_document = isinstance(document, list) or (
        isinstance(document, dict) and not any(map(_is_row, document.values()))
    )
    return document if is_document else read_lines(text)


def _is_row(value: Any) -> bool:
    """Whether YAML took several numbers for a text."""
    words = value.split() if isinstance(value, str) else []
    return len(words) > 1 and not any(isinstance(number_of(word), str) for word in words)


def _yaml(text: str) -> Any:
    """The document, or all of them: a topic that is printed ends each message with ``---``."""
    if text.lstrip().startswith("%YAML:"):  # OpenCV's header, which is not YAML's
        text = text.lstrip().partition("\n")[2]
    documents = [document for document in yaml.load_all(text, _Loader) if document is not None]
    return documents if len(documents) > 1 else next(iter(documents), None)


def _xml(text: str) -> Any:
    """OpenCV's FileStorage: elements are entries, their text is a number, a word, or numbers."""
    if "<!" in text.replace("<!--", ""):
        raise ValueError("its document type definitions are not read")
    root = ElementTree.fromstring(text)
    if root.tag != "opencv_storage":
        raise ValueError(f"its root is <{root.tag}>, not <opencv_storage>")
    return _element(root)


def _element(element: ElementTree.Element) -> Any:
    if len(element):
        return _unique([(child.tag, _element(child)) for child in element])
    words = (element.text or "").split()
    values = [number_of(word) for word in words]
    return values if element.tag == "data" or len(values) != 1 else values[0]


def _arrays(raw: bytes) -> Any:
    """NPY's matrix, or the arrays of numbers of an NPZ, as OpenCV's tutorial saves them."""
    try:
        loaded = np.load(io.BytesIO(raw), allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return loaded.tolist()
        return {name: loaded[name].tolist() for name in loaded.files}
    except (OSError, KeyError, AttributeError, BadZipFile) as error:  # damaged, or an archive of something else
        raise ValueError(error) from None
