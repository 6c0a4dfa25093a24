"""From a mesh file to an object in meters."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from evalkit.atomic import sha256_of_file
from evalkit.meshes.read import FileMesh, read_file_mesh, read_mesh
from evalkit.meshes.units import METERS, check_size, decide_units
from evalkit.objects.model import ObjectModel
from evalkit.objects.symmetry_detection import resolve_symmetry

__all__ = ["load_object", "read_mesh"]

log = logging.getLogger(__name__)


def load_object(
    path: Path, units: str | None = "auto", symmetry: str | None = None, name: str | None = None
) -> ObjectModel:
    """The object that a mesh file describes; doubts about its unit are logged as warnings.

    Args:
        units: the file's unit, as :func:`evalkit.meshes.units.decide_units` takes it; None is "auto".
        symmetry: as :func:`evalkit.objects.symmetry_detection.resolve_symmetry` takes it; None detects it.
        name: None takes the file's.

    Raises:
        InputError: the file is not a usable mesh, its unit is unknown or gives no plausible size, or `symmetry` is
            not known.
    """
    mesh = read_file_mesh(path)
    if path.suffix.lower() == ".stl":
        mesh = _with_shared_corners(mesh)
    largest_side = float(np.ptp(mesh.vertices[np.unique(mesh.faces)], axis=0).max())
    extension = path.suffix.lower().lstrip(".")
    unit, reason, warnings = decide_units(units or "auto", largest_side, extension, str(path), mesh.unit)
    warnings += check_size(largest_side * METERS[unit], str(path))
    for warning in warnings:
        log.warning("%s: %s", path, warning)
    log.info("%s: read in %s, %s", path, unit, reason)
    vertices = mesh.vertices * METERS[unit]
    group = resolve_symmetry(vertices, mesh.faces, symmetry or "auto").symmetry
    notes = {"mesh": path.name, "mesh_sha256": sha256_of_file(path), "units": unit}
    return ObjectModel.from_mesh(name or path.stem, vertices, mesh.faces, group, **notes)


def _with_shared_corners(mesh: FileMesh) -> FileMesh:
    """STL gives every facet corners of its own: those in one place become one vertex, as other formats have it."""
    vertices, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    return FileMesh(vertices, index.reshape(-1)[mesh.faces], mesh.unit)
