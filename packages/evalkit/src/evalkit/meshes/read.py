"""From a mesh file to vertices and faces: one reader for every format and every package."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.meshes import polygon_ply, polygon_text, threemf, trimesh_formats
from evalkit.meshes.mesh_file_error import MeshFileError
from evalkit.meshes.polygons import triangulate

POLYGON_READERS = {"ply": polygon_ply.read_ply, "obj": polygon_text.read_obj, "off": polygon_text.read_off}
METER_READERS = {
    "glb": trimesh_formats.read_gltf,
    "gltf": trimesh_formats.read_gltf,
    "step": trimesh_formats.read_step,
    "stp": trimesh_formats.read_step,
}
FORMATS = (*POLYGON_READERS, "stl", "3mf", *METER_READERS)


@dataclass(frozen=True, eq=False)
class FileMesh:
    """A triangle mesh as its file holds it.

    Attributes:
        vertices: (V, 3), in `unit` where the file states one.
        faces: vertex indices (F, 3), counter-clockwise seen from outside if the file is sound.
        unit: a key of :data:`evalkit.meshes.units.METERS`, or None where the format states no unit.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    unit: str | None


def read_file_mesh(path: Path) -> FileMesh:
    """The triangles of a mesh file of one of :data:`FORMATS`; all its parts as one mesh, each in its place.

    Raises:
        InputError: there is no such file, it is of another kind or damaged, or it holds no triangles or no finite
            numbers.
        OSError: it cannot be read.
    """
    extension = _known_extension(path)
    data = path.read_bytes()
    if not data:
        raise InputError(f"{path}: is empty; export the mesh again.")
    try:
        mesh = _parse(data, path, extension)
    except MeshFileError as fault:
        advice = "" if ";" in str(fault) else "; export the mesh again"
        raise InputError(f"{path}: {fault}{advice}.") from None
    except MemoryError:
        raise InputError(f"{path}: too large for this machine's memory; decimate the mesh first.") from None
    except Exception:  # a parser fed with arbitrary bytes raises anything, and its own words mean nothing to a user
        raise InputError(
            f"{path}: cannot be read as {extension.upper()}, so it is truncated, damaged or of another kind; "
            "export it again."
        ) from None
    _require_surface(mesh, path)
    return mesh


def read_mesh(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (V, 3) and triangles (F, 3), as :func:`read_file_mesh` reads them, for whom the unit is settled."""
    mesh = read_file_mesh(path)
    return mesh.vertices, mesh.faces


def _known_extension(path: Path) -> str:
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give a mesh file ({', '.join(FORMATS)}).")
    extension = path.suffix.lower().lstrip(".")
    if extension not in FORMATS:
        raise InputError(f"{path}: '{path.suffix}' is not a mesh format read here; convert it to PLY, STL or OBJ.")
    if not path.exists():
        raise InputError(f"{path}: no such file; check the path.")
    return extension


def _parse(data: bytes, path: Path, extension: str) -> FileMesh:
    if extension in POLYGON_READERS:
        vertices, polygons = POLYGON_READERS[extension](data)
        return FileMesh(vertices, triangulate(vertices, polygons), None)
    if extension == "3mf":
        mesh, unit = threemf.read_3mf(data)
        return FileMesh(*mesh, unit)
    if extension == "stl":
        return FileMesh(*trimesh_formats.read_stl(data, path), None)
    return FileMesh(*METER_READERS[extension](data, path), "m")


def _require_surface(mesh: FileMesh, path: Path) -> None:
    if len(mesh.faces) == 0:
        raise InputError(f"{path}: holds no triangles; export it as a triangle mesh, not as points or curves.")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise InputError(f"{path}: a face names a vertex that the file lacks; it is damaged, export it again.")
    if not np.isfinite(mesh.vertices[np.unique(mesh.faces)]).all():
        raise InputError(f"{path}: some vertices are not finite numbers (NaN or infinity); export it again.")
