"""Triangle meshes in Wavefront OBJ files."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import write_text
from evalkit.errors import InputError


def read_obj(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices (V, 3) and triangles (F, 3); polygons become fans.

    Raises:
        InputError: it has no faces, or a line cannot be read.
    """
    vertices, faces = [], []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        kind, *words = line.split() or [""]
        try:
            if kind == "v":
                vertices.append([float(word) for word in words[:3]])
            elif kind == "f":
                corner = [int(word.split("/")[0]) for word in words]
                faces += [[corner[0], b, c] for b, c in pairwise(corner[1:])]
        except ValueError:
            raise InputError(f"{path}: the line '{line[:40]}' is not Wavefront OBJ.") from None
    triangles = np.array(faces, np.int32).reshape(-1, 3)
    triangles = np.where(triangles > 0, triangles - 1, triangles + len(vertices))
    corners_known = len(triangles) and triangles.min() >= 0 and triangles.max() < len(vertices)
    if not corners_known or any(len(vertex) != 3 for vertex in vertices):
        raise InputError(f"{path}: the mesh has no faces, or they name vertices that it lacks.")
    return np.array(vertices), triangles


def write_obj(path: Path, vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> None:
    """Write vertices (V, 3) and triangles (F, 3) such that :func:`read_obj` gives the very same numbers."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(vertices, float).tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (np.asarray(faces) + 1).tolist()]
    write_text(path, "\n".join(lines) + "\n")
