"""From a mesh file, or a built-in object's name, to an object in metres with symmetry and convex parts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from evalkit.atomic import sha256_of_file
from evalkit.errors import InputError
from evalkit.objects import ObjectModel
from evalkit.symmetry import Symmetry
from simgen.builtin_objects import BUILTIN_OBJECTS
from simgen.convex import Part, convex_parts

UNITS = {"m": 1.0, "mm": 1e-3}


@dataclass(frozen=True, eq=False)
class PreparedObject:
    """What `prepare_object` understood of a mesh."""

    model: ObjectModel  # metres, with symmetry and mesh
    convex_parts: list[Part]  # (vertices (V, 3), faces (F, 3)) metres, object's frame
    warnings: list[str]  # sentences to print


def prepare_object(source: str, units: str = "auto", scale: float = 1.0, symmetry: str = "auto") -> PreparedObject:
    """Read `source`, a mesh file or a built-in object's name, as an object in metres.

    Raises:
        InputError: the file is not a usable mesh, or an option makes no sense.
    """
    name, vertices, faces, notes = _read(source)
    warnings: list[str] = []
    factor = UNITS.get(units, 1.0 if np.ptp(vertices, 0).max() < 2.0 else 1e-3)
    vertices = vertices * (factor * scale)
    parts, convex_warnings = convex_parts(vertices, faces)
    model = ObjectModel.from_mesh(name, vertices, faces, Symmetry.parse("none" if symmetry == "auto" else symmetry))
    notes |= {"units": "m" if factor == 1.0 else "mm", "scale": scale}
    return PreparedObject(replace(model, notes=notes), parts, [*warnings, *convex_warnings])


def _read(source: str) -> tuple[str, NDArray[np.float64], NDArray[np.int32], dict[str, Any]]:
    if source in BUILTIN_OBJECTS:
        builtin = BUILTIN_OBJECTS[source]
        vertices, faces = builtin.make()
        return source, vertices, faces, {"source": source, "origin": builtin.origin}
    path = Path(source)
    if not path.is_file():
        raise InputError(f"--object {source}: no such file, nor a built-in object ({', '.join(BUILTIN_OBJECTS)}).")
    mesh = trimesh.load_mesh(path)
    return (
        path.stem,
        np.asarray(mesh.vertices, float),
        np.asarray(mesh.faces, np.int32),
        {"source": path.name, "sha256": sha256_of_file(path)},
    )
