"""Reading triangle meshes: every format that trimesh knows, every failure one sentence."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from evalkit.errors import InputError

FORMATS = ("ply", "stl", "obj", "off", "glb", "gltf")


def read_mesh(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (V, 3) and faces (F, 3) of a mesh file, in the file's units; a scene's parts in their places.

    Raises:
        InputError: there is no such file, it is of another kind, or it holds no triangles or no finite numbers.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give a mesh file ({', '.join(FORMATS)}).")
    if not path.is_file():
        raise InputError(f"{path}: no such file; check the path.")
    extension = path.suffix.lower().lstrip(".")
    if extension not in FORMATS:
        raise InputError(f"{path}: '{path.suffix}' is not a mesh format read here; convert it to PLY, STL or OBJ.")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: is empty; export the mesh again.")
    vertices, faces = _load(path)
    if len(faces) == 0:
        raise InputError(f"{path}: holds no triangles; export it as a triangle mesh, not as points or curves.")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"{path}: a face names a vertex that the file lacks; it is damaged, export it again.")
    if not np.isfinite(vertices[np.unique(faces)]).all():
        raise InputError(f"{path}: some vertices are not finite numbers (NaN or infinity); export it again.")
    return vertices, faces


def _load(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The file's meshes as one."""
    try:
        with _silent_trimesh():
            mesh = trimesh.load_scene(path, process=False).to_mesh()
            return np.array(mesh.vertices, float).reshape(-1, 3), np.array(mesh.faces, np.int64).reshape(-1, 3)
    except MemoryError:
        raise InputError(f"{path}: too large for this machine's memory; decimate the mesh first.") from None
    except Exception as error:  # a parser fed with arbitrary bytes raises anything
        if isinstance(error, OSError) and error.filename == str(path):
            raise
        kind = path.suffix.lower().lstrip(".").upper()  # and the parser's own words mean nothing to its user
        raise InputError(
            f"{path}: cannot be read as {kind}, so it is truncated, damaged or of another kind; export it again."
        ) from None


@contextmanager
def _silent_trimesh() -> Iterator[None]:
    """trimesh logs tracebacks of what it then raises."""
    log = logging.getLogger("trimesh")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        log.setLevel(level)
