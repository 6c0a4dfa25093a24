"""Polygons in Wavefront OBJ and in OFF files.

trimesh reads both, but cuts their polygons as fans, and counts OBJ's relative indices from the end of the file where
the format counts them from the line that holds them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from evalkit.meshes.mesh_file_error import MeshFileError
from evalkit.meshes.polygons import Polygons

Mesh = tuple[NDArray[np.float64], Polygons]
OBJ_SURFACES = (b"surf", b"curv", b"curv2")


def read_obj(data: bytes) -> Mesh:
    """Vertices (V, 3) and polygons of a Wavefront OBJ file's content; points and lines are left out.

    Raises:
        MeshFileError: a line cannot be read, or it holds free-form surfaces.
    """
    vertices: list[list[float]] = []
    counts: list[int] = []
    corners: list[int] = []
    for line in _lines(data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")):
        kind, *words = line.split()
        try:
            if kind == b"v":
                vertices.append([float(words[0]), float(words[1]), float(words[2])])
            elif kind in (b"f", b"fo"):
                face = [_from_zero(int(word.partition(b"/")[0]), len(vertices)) for word in words]
                counts.append(len(face))
                corners += face
        except (ValueError, IndexError):
            raise MeshFileError(f"the line '{line[:40].decode(errors='replace')}' is not Wavefront OBJ") from None
        if kind in OBJ_SURFACES:
            raise MeshFileError("it holds free-form curves or surfaces, not triangles")
    return np.array(vertices, float).reshape(-1, 3), Polygons(np.array(counts, np.int64), np.array(corners, np.int64))


def read_off(data: bytes) -> Mesh:
    """Vertices (V, 3) and polygons of an OFF file's content; colors, normals and texture coordinates are left out.

    Raises:
        MeshFileError: it is not OFF, of a binary or four-dimensional kind, or a line cannot be read.
    """
    rows = [line.split() for line in _lines(data)]
    if not rows or not re.fullmatch(rb"(ST)?C?N?OFF", rows[0][0].upper()):
        raise MeshFileError("it does not begin with the word OFF, or is of a kind in other than three dimensions")
    if b"BINARY" in rows[0]:
        raise MeshFileError("it is a binary OFF file, which is not read here; write it as text")
    rows = [rows[0][1:], *rows[1:]] if len(rows[0]) > 1 else rows[1:]
    try:
        vertex_count, face_count = int(rows[0][0]), int(rows[0][1])
        if not 0 <= vertex_count + face_count <= len(rows) - 1 or min(vertex_count, face_count) < 0:
            raise MeshFileError(f"the file ends before its {vertex_count} vertices and {face_count} faces")
        vertices = np.array([row[:3] for row in rows[1 : vertex_count + 1]], float).reshape(vertex_count, 3)
        faces = [row[1 : int(row[0]) + 1] for row in rows[vertex_count + 1 : vertex_count + face_count + 1]]
        short = any(len(face) != int(row[0]) for face, row in zip(faces, rows[vertex_count + 1 :], strict=False))
        corners = np.array([int(word) for face in faces for word in face], np.int64)
    except (ValueError, IndexError, OverflowError):
        raise MeshFileError("a line does not hold the numbers that OFF asks for") from None
    if short:
        raise MeshFileError("a face holds fewer vertices than it announces")
    return vertices, Polygons(np.array([len(face) for face in faces], np.int64), corners)


def _lines(data: bytes) -> Iterator[bytes]:
    """Lines with something on them, without comments."""
    for line in data.removeprefix(b"\xef\xbb\xbf").splitlines():
        line = line.partition(b"#")[0].strip()
        if line:
            yield line


def _from_zero(index: int, vertex_count: int) -> int:
    """A corner's index from 0; OBJ counts from 1, and backwards from the last vertex so far with negative ones."""
    if index == 0 or index < -vertex_count:
        raise ValueError
    return index - 1 if index > 0 else vertex_count + index
