"""Objects that need no file: known by name, in metres, z up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pybullet_data
import trimesh
from numpy.typing import NDArray

Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]
BUNNY_METRES_PER_UNIT = 0.05  # nose to tail 1.97 units in the file: a 10 cm bunny


@dataclass(frozen=True)
class BuiltinObject:
    """A named object: `make` gives vertices (V, 3) in metres and faces (F, 3); `origin` says where they come from."""

    make: Callable[[], Mesh]
    symmetry: str
    origin: str


def bunny() -> Mesh:
    """PyBullet's bunny.obj (902 faces), one round of Loop subdivision (3608), turned from y up to z up, 10 cm long."""
    mesh = trimesh.load_mesh(Path(pybullet_data.getDataPath()) / "bunny.obj", process=False)
    vertices, faces = trimesh.remesh.subdivide_loop(mesh.vertices, mesh.faces, iterations=1)
    x, y, z = np.asarray(vertices, float).T * BUNNY_METRES_PER_UNIT
    return np.stack([x, -z, y], -1), np.asarray(faces, np.int64)


BUILTIN_OBJECTS: dict[str, BuiltinObject] = {
    "bunny": BuiltinObject(bunny, "none", "bunny.obj of pybullet_data, subdivided once, 10 cm long"),
}
