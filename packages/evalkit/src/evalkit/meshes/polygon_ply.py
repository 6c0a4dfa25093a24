"""Polygons in PLY files (Turk 1994), as text and binary of both byte orders.

trimesh reads PLY too, but cuts polygons as fans and takes no binary file that mixes triangles and larger polygons.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from evalkit.meshes.mesh_file_error import MeshFileError
from evalkit.meshes.polygons import Polygons

TYPES = {
    "char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d",
    "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f",
    "float64": "d",
}  # fmt: skip
BYTE_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
INDEX_NAMES = ("vertex_indices", "vertex_index")

Numbers = NDArray[np.float64]
Lists = tuple[NDArray[np.int64], Numbers]  # how many numbers each row holds (n,), and the numbers of all rows


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


def read_ply(data: bytes) -> tuple[NDArray[np.float64], Polygons]:
    """Vertices (V, 3) and polygons of a PLY file's content, triangle strips as triangles.

    Raises:
        MeshFileError: it is not PLY, ends early, or holds no faces.
    """
    encoding, elements, body = _parse_header(data)
    if encoding == "ascii":
        body, elements = _as_binary(body, elements)
    tables: dict[str, dict[str, Numbers | Lists]] = {}
    start = 0
    for element in elements:
        try:
            tables[element.name], start = _read_rows(body, start, element, BYTE_ORDERS[encoding])
        except (ValueError, OverflowError, struct.error):
            raise MeshFileError(f"the file ends before its {element.count} rows of '{element.name}'") from None
    if encoding == "ascii" and start < len(body):
        raise MeshFileError("its rows do not hold the numbers that the header announces")
    return _vertices(tables.get("vertex", {})), _polygons(tables)


def _parse_header(data: bytes) -> tuple[str, list[_Element], bytes]:
    head, end, body = data.partition(b"end_header")
    lines = [line.split() for line in head.decode("ascii", errors="replace").splitlines() if line.strip()]
    if not end or not lines or lines[0] != ["ply"]:
        raise MeshFileError("the file does not begin with a PLY header")
    encoding, elements = "", list[_Element]()
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
                case ["format" | "element" | "property", *_]:
                    raise ValueError
        except (ValueError, KeyError, IndexError):
            raise MeshFileError(f"the header line '{' '.join(words)[:40]}' is not PLY") from None
    if encoding not in BYTE_ORDERS:
        raise MeshFileError(f"the format '{encoding[:40]}' is not known")
    if any(element.count < 0 for element in elements):
        raise MeshFileError("the header announces fewer than no rows")
    return encoding, elements, body.partition(b"\n")[2]


def _as_binary(body: bytes, elements: list[_Element]) -> tuple[bytes, list[_Element]]:
    """Text as the binary file that holds all its numbers as doubles."""
    try:
        numbers = np.array(body.split(), "<f8")
    except ValueError:
        raise MeshFileError("its rows hold something other than numbers") from None
    doubles = [
        _Element(e.name, e.count, [_Property(p.name, "d", "d" if p.count_type else None) for p in e.properties])
        for e in elements
    ]
    return numbers.tobytes(), doubles


def _read_rows(body: bytes, start: int, element: _Element, order: str) -> tuple[dict[str, Numbers | Lists], int]:
    """The columns of an element by their names, and where the next element begins."""
    if element.count == 0 or not element.properties:
        return {}, start
    lengths, _, _ = _walk_row(body, start, element, order)
    row = np.dtype([part for i, p in enumerate(element.properties) for part in _fields(i, p, lengths[i], order)])
    if len(body) - start >= row.itemsize * element.count:
        table = np.frombuffer(body, row, element.count, start)
        if all((table[f"length {i}"] == lengths[i]).all() for i, p in enumerate(element.properties) if p.count_type):
            columns = {p.name: _column(table, i, p) for i, p in enumerate(element.properties)}
            return columns, start + row.itemsize * element.count
    return _read_ragged_rows(body, start, element, order)


def _fields(i: int, p: _Property, length: int, order: str) -> list[tuple[str, str] | tuple[str, str, tuple[int]]]:
    if p.count_type is None:
        return [(f"{i}", order + p.type)]
    return [(f"length {i}", order + p.count_type), (f"{i}", order + p.type, (length,))]


def _column(table: NDArray[np.void], i: int, p: _Property) -> Numbers | Lists:
    if p.count_type is None:
        return table[f"{i}"].astype(float)
    return table[f"length {i}"].astype(np.int64), table[f"{i}"].astype(float).reshape(-1)


def _read_ragged_rows(body: bytes, start: int, element: _Element, order: str) -> tuple[dict[str, Numbers | Lists], int]:
    """As :func:`_read_rows`, where lists are of various lengths."""
    counts: list[list[int]] = [[] for _ in element.properties]
    values: list[list[float]] = [[] for _ in element.properties]
    for _ in range(element.count):
        lengths, row, start = _walk_row(body, start, element, order)
        for i, some in enumerate(row):
            counts[i].append(lengths[i])
            values[i].extend(some)
    columns: dict[str, Numbers | Lists] = {}
    for i, p in enumerate(element.properties):
        numbers = np.array(values[i], float)
        columns[p.name] = (np.array(counts[i], np.int64), numbers) if p.count_type else numbers
    return columns, start


def _walk_row(body: bytes, start: int, element: _Element, order: str) -> tuple[list[int], list[tuple[float, ...]], int]:
    """How many numbers each property of a row has, the numbers, and where the next row begins."""
    lengths, row = list[int](), list[tuple[float, ...]]()
    for p in element.properties:
        length = 1
        if p.count_type:
            (announced,) = struct.unpack_from(order + p.count_type, body, start)
            start += struct.calcsize(order + p.count_type)
            length = int(announced)
            if length < 0 or length != announced or length > len(body):
                raise ValueError
        layout = f"{order}{length}{p.type}"
        row.append(struct.unpack_from(layout, body, start))
        start += struct.calcsize(layout)
        lengths.append(length)
    return lengths, row, start


def _vertices(columns: dict[str, Numbers | Lists]) -> NDArray[np.float64]:
    axes = [columns.get(axis) for axis in "xyz"]
    if not all(isinstance(axis, np.ndarray) for axis in axes):
        raise MeshFileError("it has no element 'vertex' with x, y and z")
    return np.stack(axes, -1)  # type: ignore[arg-type]


def _polygons(tables: dict[str, dict[str, Numbers | Lists]]) -> Polygons:
    found = [Polygons(np.zeros(0, np.int64), np.zeros(0, np.int64))]
    for element in ("face", "tristrips"):
        for name in INDEX_NAMES:
            lists = tables.get(element, {}).get(name)
            if isinstance(lists, tuple):
                polygons = Polygons(lists[0], _indices(lists[1]))
                found.append(polygons if element == "face" else _strips(polygons))
                break
    if sum(len(polygons.counts) for polygons in found) == 0:
        raise MeshFileError("it has no faces, so it is a cloud of points and no surface")
    return Polygons.joined(found)


def _indices(numbers: Numbers) -> NDArray[np.int64]:
    if not np.isfinite(numbers).all() or (numbers % 1).any():
        raise MeshFileError("a face names a vertex by a number that is not whole")
    return numbers.astype(np.int64)


def _strips(lists: Polygons) -> Polygons:
    """Triangles of strips, in which -1 ends a strip and every second triangle is wound the other way."""
    triangles: list[NDArray[np.int64]] = [np.zeros((0, 3), np.int64)]
    for strips in np.split(lists.corners, np.cumsum(lists.counts)[:-1]):
        for strip in np.split(strips, np.flatnonzero(strips == -1)):
            strip = strip[strip != -1]
            if len(strip) >= 3:
                corners = np.stack([strip[:-2], strip[1:-1], strip[2:]], -1)
                corners[1::2] = corners[1::2, [1, 0, 2]]
                triangles.append(corners)
    flat = np.concatenate(triangles)
    distinct = (flat != np.roll(flat, 1, axis=1)).all(1)  # repeated corners join one strip to the next
    flat = flat[distinct]
    return Polygons(np.full(len(flat), 3, np.int64), flat.reshape(-1))
