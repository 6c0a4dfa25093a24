"""Triangle meshes to PLY and OBJ files, with all digits of their vertices."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import atomic_path, write_text


def write_ply(path: Path, vertices: NDArray[np.float64], faces: NDArray[Any], normals: NDArray[np.float64]) -> None:
    """Write vertices (V, 3), their unit normals (V, 3) and triangles (F, 3), binary."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property double {axis}" for axis in "xyz"] + [f"property float n{axis}" for axis in "xyz"]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    rows = np.empty(len(vertices), [("position", "<f8", 3), ("normal", "<f4", 3)])
    rows["position"], rows["normal"] = vertices, normals
    triangles = np.empty(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    triangles["count"], triangles["corners"] = 3, faces
    with atomic_path(path) as temporary:
        temporary.write_bytes("\n".join(header).encode() + rows.tobytes() + triangles.tobytes())


def write_obj(path: Path, vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> None:
    """Write vertices (V, 3) and triangles (F, 3)."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(vertices, float).tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (np.asarray(faces) + 1).tolist()]
    write_text(path, "\n".join(lines) + "\n")
