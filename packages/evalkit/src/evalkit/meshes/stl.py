"""Triangle meshes in STL files, ASCII and binary."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError

HEADER_BYTES = 84
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (V, 3) in the file's unit, equal ones merged, and triangles (F, 3).

    Raises:
        InputError: the file is no STL, or is damaged.
        OSError: it cannot be read.
    """
    data = path.read_bytes()
    corners = _binary_corners(data)
    if corners is None:
        corners = _ascii_corners(data)
    if corners is None or len(corners) == 0:
        raise InputError(f"{path}: is not an STL mesh, or is truncated; export the mesh again as STL.")
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return vertices.astype(float), index.reshape(-1, 3).astype(np.int64)


def _binary_corners(data: bytes) -> NDArray[np.float32] | None:
    """Corners (F, 3, 3) if the size is the one that the header's count asks for; "solid" proves nothing."""
    if len(data) < HEADER_BYTES:
        return None
    count = int.from_bytes(data[HEADER_BYTES - 4 : HEADER_BYTES], "little")
    if len(data) != HEADER_BYTES + count * FACET.itemsize:
        return None
    return np.frombuffer(data, FACET, count, HEADER_BYTES)["corners"]


def _ascii_corners(data: bytes) -> NDArray[np.float32] | None:
    if data.lstrip()[:5].lower() != b"solid":
        return None
    words = [line.split() for line in data.decode("ascii", errors="replace").splitlines()]
    rows = [line[1:4] for line in words if line and line[0].lower() == "vertex"]
    try:
        return np.array(rows, np.float32).reshape(-1, 3, 3)
    except ValueError:
        return None
