"""A camera file as a document: JSON, YAML, OpenCV's FileStorage (YAML 1.0, XML, JSON), lines of words, NPY."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml

from evalkit.errors import InputError

FORMATS = (
    "give width, height, fx, fy, cx, cy as JSON, a BOP camera.json, a ROS camera_info, OpenCV's calibration file, or "
    "what RealSense, Open3D, Zivid, Kalibr, COLMAP or Siléane write"
)
NPY = b"\x93NUMPY"
LARGEST_FILE = 1 << 20  # bytes; such files hold a few hundred


class ColmapRows(list[list[Any]]):
    """The rows of a COLMAP cameras.txt: number, model, width, height and parameters, each at least five words."""


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """YAML as OpenCV writes it: matrices are tagged, and are plain mappings otherwise."""


_Loader.add_constructor(
    "tag:yaml.org,2002:opencv-matrix", lambda loader, node: loader.construct_mapping(node, deep=True)
)


def parse(path: Path) -> Any:
    """The document in a camera file, recognized by its content, not by its name.

    Raises:
        InputError: the file is too large, or is none of these formats.
        OSError: it cannot be read.
    """
    with open(path, "rb") as file:
        raw = file.read(LARGEST_FILE + 1)
    if len(raw) > LARGEST_FILE:
        raise InputError(f"{path}: too large for a camera file; {FORMATS}.")
    kind = "camera"
    try:
        if raw.startswith(NPY):
            return np.load(io.BytesIO(raw), allow_pickle=False).tolist()
        text = raw.decode("utf-8-sig")
        kind, read = _reader(text.lstrip(), path.suffix.lower())
        return read(text)
    except yaml.MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f" in line {error.problem_mark.line + 1}"
        raise InputError(f"{path}: not a YAML file ({error.problem or error.context}{line}); {FORMATS}.") from None
    except (ValueError, RecursionError, yaml.YAMLError, ElementTree.ParseError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{path}: not a {kind} file ({reason}); {FORMATS}.") from None


def _reader(text: str, suffix: str) -> tuple[str, Any]:
    """What kind of text it is, and the function that reads it."""
    if text.startswith("<"):
        return "XML", _xml
    if text.startswith("{") or suffix == ".json":
        return "JSON", json.loads
    if suffix == ".txt" and not text.startswith(("%YAML", "---")):
        return "text", _lines
    return "YAML", _yaml


def _yaml(text: str) -> Any:
    """The first document that is not empty: a topic that is printed ends each message with ``---``."""
    if text.lstrip().startswith("%YAML:"):  # OpenCV's header, which is not YAML's
        text = text.lstrip().partition("\n")[2]
    return next((document for document in yaml.load_all(text, _Loader) if document is not None), None)


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
        return {child.tag: _element(child) for child in element}
    words = (element.text or "").split()
    values = [_number(word) for word in words]
    return values if element.tag == "data" or len(values) != 1 else values[0]


def _lines(text: str) -> Any:
    """Lines ``key value …`` as Siléane's camera_params.txt has them; COLMAP's rows come under 'colmap'.

    Numbers alone are rows of a matrix, as numpy.savetxt writes it.
    """
    lines = (line.replace(",", " ") for line in text.splitlines())
    rows = [line.split() for line in lines if line.strip() and not line.lstrip().startswith("#")]
    matrix = [[_number(word) for word in row] for row in rows]
    if matrix and not any(isinstance(value, str) for row in matrix for value in row):
        return matrix if len(matrix) > 1 else matrix[0]
    if rows and all(len(row) >= 5 and row[0].isdecimal() and row[1].isupper() for row in rows):
        return {"colmap": ColmapRows([_number(word) for word in row] for row in rows)}
    lists = {row[0].rstrip(":="): [_number(word) for word in row[1:] if word not in ":="] for row in rows}
    return {key: values[0] if len(values) == 1 else values for key, values in lists.items()}


def _number(word: str) -> float | int | str:
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            continue
    return word
