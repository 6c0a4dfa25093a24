"""Triangle meshes in PLY files (Turk 1994), ASCII and binary of both byte orders."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import atomic_path
from evalkit.errors import InputError

Array = NDArray[np.float64]
Columns = dict[str, Any]  # property name -> (n,) numbers, or for lists (n, k) numbers or n arrays of various lengths
TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class _Property:
    name: str
    type: str
    count_type: str | None = None  # of a list's length; None for one number


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


class _DamageError(Exception):
    """What is wrong with the file, to be said with its name."""


def read_ply(path: Path) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3) in the file's unit and triangles (F, 3); polygons become fans.

    Raises:
        InputError: the file is no PLY mesh, or is damaged; the sentence says where.
        OSError: it cannot be read.
    """
    data = path.read_bytes()
    try:
        encoding, elements, body = _parse_header(data)
        tables = _read_ascii(body, elements) if encoding == "ascii" else _read_binary(body, elements, encoding)
        return _vertices(tables), _triangles(tables)
    except _DamageError as fault:
        raise InputError(f"{path}: {fault}; export the mesh again as PLY.") from None


def write_ply(path: Path, vertices: Array, faces: NDArray[Any], normals: Array) -> None:
    """Write vertices (V, 3), their unit normals (V, 3) and triangles (F, 3), binary; vertices keep all their digits."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property double {axis}" for axis in "xyz"] + [f"property float n{axis}" for axis in "xyz"]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    rows = np.empty(len(vertices), [("position", "<f8", 3), ("normal", "<f4", 3)])
    rows["position"], rows["normal"] = vertices, normals
    triangles = np.empty(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    triangles["count"], triangles["corners"] = 3, faces
    with atomic_path(path) as temporary:
        temporary.write_bytes("\n".join(header).encode() + rows.tobytes() + triangles.tobytes())


def _parse_header(data: bytes) -> tuple[str, list[_Element], bytes]:
    head, end, body = data.partition(b"end_header")
    lines = [line.split() for line in head.decode("ascii", errors="replace").splitlines()]
    if not end or not lines or lines[0] != ["ply"]:
        raise _DamageError("the file does not begin with a PLY header")
    encoding, elements = "", []
    for words in lines[1:]:
        try:
            match words:
                case ["format", name, _]:
                    encoding = name
                case ["element", name, count]:
                    elements.append(_Element(name, int(count)))
                case ["property", "list", count_type, kind, name]:
                    elements[-1].properties.append(_Property(name, TYPES[kind], TYPES[count_type]))
                case ["property", kind, name]:
                    elements[-1].properties.append(_Property(name, TYPES[kind]))
        except (ValueError, KeyError, IndexError):
            raise _DamageError(f"the header line '{' '.join(words)[:40]}' is not PLY") from None
    if encoding not in ("ascii", *BYTE_ORDERS) or any(element.count < 0 for element in elements):
        raise _DamageError(f"the format '{encoding[:40]}' is not known")
    return encoding, elements, body[2:] if body.startswith(b"\r\n") else body[1:]


def _read_ascii(body: bytes, elements: list[_Element]) -> dict[str, Columns]:
    lines = [line for line in body.split(b"\n") if line.strip()]
    tables, start = {}, 0
    for element in elements:
        rows = lines[start : start + element.count]
        start += element.count
        if len(rows) < element.count:
            raise _DamageError(f"the file ends before its {element.count} rows of '{element.name}'")
        try:
            tables[element.name] = _ascii_columns([row.split() for row in rows], element)
        except (ValueError, IndexError, OverflowError):
            raise _DamageError(
                f"a row of '{element.name}' does not hold the numbers that the header announces"
            ) from None
    return tables


def _ascii_columns(rows: list[list[bytes]], element: _Element) -> Columns:
    if len({len(row) for row in rows}) <= 1:
        table = np.array(rows, float).reshape(len(rows), -1)
        columns = _split_even(table, element)
        if columns is not None:
            return columns
    return _gather([_split_row([float(word) for word in row], element) for row in rows], element)


def _split_even(table: Array, element: _Element) -> Columns | None:
    """Columns of a table whose lists are equally long in all rows; None if they are not."""
    columns: Columns = {}
    at = 0
    for p in element.properties:
        width = 1
        if p.count_type:
            counts = table[:, at]
            if len(counts) and (counts != counts[0]).any():
                return None
            width, at = int(counts[0]) if len(counts) else 0, at + 1
        columns[p.name] = table[:, at : at + width] if p.count_type else table[:, at]
        at += width
    return columns


def _split_row(numbers: list[float], element: _Element) -> list[Any]:
    values, at = [], 0
    for p in element.properties:
        width = int(numbers[at]) if p.count_type else 1
        at += 1 if p.count_type else 0
        values.append(np.array(numbers[at : at + width]) if p.count_type else numbers[at])
        at += width
    return values


def _gather(rows: list[list[Any]], element: _Element) -> Columns:
    return {
        p.name: [row[i] for row in rows] if p.count_type else np.array([row[i] for row in rows], float)
        for i, p in enumerate(element.properties)
    }


def _read_binary(body: bytes, elements: list[_Element], encoding: str) -> dict[str, Columns]:
    order, tables, start = BYTE_ORDERS[encoding], {}, 0
    for element in elements:
        try:
            tables[element.name], start = _binary_columns(body, start, element, order)
        except (ValueError, IndexError):
            raise _DamageError(f"the file ends before its {element.count} rows of '{element.name}'") from None
    return tables


def _binary_columns(body: bytes, start: int, element: _Element, order: str) -> tuple[Columns, int]:
    if element.count == 0:
        return {p.name: np.zeros((0, 3) if p.count_type else 0) for p in element.properties}, start
    _, _, lengths = _walk_row(body, start, element, order)
    row = np.dtype([part for p in element.properties for part in _fields(p, lengths, order)])
    if len(body) - start >= row.itemsize * element.count:
        table = np.frombuffer(body, row, element.count, start)
        if all((table[f"length of {name}"] == length).all() for name, length in lengths.items()):
            return {p.name: table[p.name] for p in element.properties}, start + row.itemsize * element.count
    if not lengths:
        raise IndexError
    rows = []
    for _ in range(element.count):
        values, start, _ = _walk_row(body, start, element, order)
        rows.append(values)
    return _gather(rows, element), start


def _fields(p: _Property, lengths: dict[str, int], order: str) -> list[Any]:
    if p.count_type is None:
        return [(p.name, order + p.type)]
    return [(f"length of {p.name}", order + p.count_type), (p.name, order + p.type, (lengths[p.name],))]


def _walk_row(body: bytes, start: int, element: _Element, order: str) -> tuple[list[Any], int, dict[str, int]]:
    """One row's values, where the next row starts, and the lengths of its lists."""
    values: list[Any] = []
    lengths = {}
    for p in element.properties:
        count = 1
        if p.count_type:
            count = lengths[p.name] = int(np.frombuffer(body, order + p.count_type, 1, start)[0])
            start += np.dtype(p.count_type).itemsize
            if count < 0:
                raise ValueError
        numbers = np.frombuffer(body, order + p.type, count, start) if count else np.zeros(0)
        start += np.dtype(p.type).itemsize * count
        values.append(numbers if p.count_type else numbers[0])
    return values, start, lengths


def _vertices(tables: dict[str, Columns]) -> Array:
    columns = tables.get("vertex", {})
    if not all(isinstance(columns.get(axis), np.ndarray) and columns[axis].ndim == 1 for axis in "xyz"):
        raise _DamageError("it has no element 'vertex' with x, y and z")
    return np.stack([np.asarray(columns[axis], float) for axis in "xyz"], -1)


def _triangles(tables: dict[str, Columns]) -> NDArray[np.int64]:
    columns = tables.get("face", {})
    polygons = columns.get("vertex_indices", columns.get("vertex_index"))
    if polygons is None or len(polygons) == 0:
        raise _DamageError("it has no faces, so it is a cloud of points and no surface")
    if isinstance(polygons, np.ndarray) and polygons.ndim == 2:
        return _fan(polygons)
    return np.concatenate([_fan(polygon[None]) for polygon in polygons])


def _fan(polygons: NDArray[Any]) -> NDArray[np.int64]:
    """Convex polygons (n, k) to triangles (n (k - 2), 3)."""
    corners = np.asarray(polygons, np.int64)
    fans = [corners[:, [0, i, i + 1]] for i in range(1, corners.shape[1] - 1)]
    return np.stack(fans, 1).reshape(-1, 3) if fans else np.zeros((0, 3), np.int64)
