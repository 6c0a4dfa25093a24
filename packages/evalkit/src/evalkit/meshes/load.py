"""From a mesh file to an object: PLY, STL and OBJ, units said and never guessed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import sha256_of_file
from evalkit.errors import InputError
from evalkit.meshes.obj import read_obj
from evalkit.meshes.ply import read_ply
from evalkit.meshes.stl import read_stl
from evalkit.objects.model import ObjectModel
from evalkit.objects.symmetry_detection import resolve_symmetry

METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "inch": 0.0254}
READERS: dict[str, Callable[[Path], tuple[NDArray[np.float64], NDArray[Any]]]] = {
    ".ply": read_ply,
    ".stl": read_stl,
    ".obj": read_obj,
}
POSSIBLE = (2e-3, 5.0)  # metres: the largest side of anything that is picked


def read_mesh(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (V, 3) in the file's unit and triangles (F, 3) of a PLY, STL or OBJ file.

    Raises:
        InputError: the file is of another kind, is damaged, or holds no finite surface.
        OSError: it cannot be read.
    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path}: '{path.suffix}' is not a mesh format read here; convert it to PLY, STL or OBJ.")
    vertices, faces = reader(path)
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"{path}: the mesh has no faces, or they name vertices that it lacks; export it again.")
    if not np.isfinite(vertices[np.unique(faces)]).all():
        raise InputError(f"{path}: some vertices are not finite numbers; export the mesh again.")
    return vertices, faces.astype(np.int64)


def load_object(path: Path, units: str | None, symmetry: str | None = None, name: str | None = None) -> ObjectModel:
    """The object that a mesh file describes.

    Args:
        units: m, cm, mm or inch: the file's unit.
        symmetry: as :func:`evalkit.objects.symmetry_detection.resolve_symmetry` takes it; None detects it.
        name: None takes the file's.

    Raises:
        InputError: the file is not a usable mesh, `units` is missing or gives no plausible size, or `symmetry` is
            not known.
    """
    if units not in METRES:
        raise InputError(f"{path}: say the mesh's unit: --units {', '.join(METRES)}.")
    vertices, faces = read_mesh(path)
    vertices = vertices * METRES[units]
    check_size(vertices[np.unique(faces)], f"{path}: read in {units}, the object")
    group = resolve_symmetry(vertices, faces, symmetry or "auto").symmetry
    notes = {"mesh": path.name, "mesh_sha256": sha256_of_file(path), "units": units}
    return ObjectModel.from_mesh(name or path.stem, vertices, faces, group, **notes)


def check_size(vertices: NDArray[np.float64], what: str) -> None:
    """Vertices (V, 3) in metres must span a size that a part can have; millimetres read as metres do not.

    Raises:
        InputError: they do not.
    """
    side = float(np.ptp(vertices, axis=0).max())
    if not POSSIBLE[0] <= side <= POSSIBLE[1]:
        raise InputError(f"{what} is {side:.4g} m across, which no part is; check the unit.")
