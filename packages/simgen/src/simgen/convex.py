"""Convex parts of a mesh, for the physics: CoACD (Wei et al., SIGGRAPH 2022), kept on disk once computed."""

from __future__ import annotations

import hashlib
import os
import zipfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

import coacd
import numpy as np
import trimesh
from numpy.typing import NDArray

from evalkit.atomic import atomic_path

Part = tuple[NDArray[np.float64], NDArray[np.int32]]
CONCAVITY = 0.15  # CoACD's threshold, on a mesh scaled into the cube [-1, 1]
MAX_PARTS = 32
MAX_PART_VERTICES = 64  # Bullet's hull code slows down and loses precision beyond
MAX_INPUT_FACES = 20_000  # CoACD's time grows with it, the parts do not change
SEED = 0
CACHE_VERSION = 1


def convex_parts(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> tuple[list[Part], list[str]]:
    """Convex parts that together follow the surface, each (vertices (V, 3), faces (F, 3)), and warnings.

    The same for the same mesh. Where CoACD fails, the one convex hull of everything.
    """
    path, warnings = _cache_path(vertices, faces), list[str]()
    cached = _read(path)
    if cached:
        return cached, warnings
    try:
        parts = _decompose(vertices, faces)
    except Exception as error:  # CoACD raises what its C++ threw
        warnings.append(
            f"CoACD could not split the mesh into convex parts ({error}); its convex hull stands in, so hollows are "
            "filled in the physics."
        )
        return [_hull(vertices[np.unique(faces)])], warnings
    try:
        _write(path, parts)
    except OSError as error:
        reason = error.strerror or error
        warnings.append(f"The convex parts could not be kept in {path.parent} ({reason}); XDG_CACHE_HOME sets another.")
    return parts, warnings


def cache_folder() -> Path:
    """Where computed parts are kept: $XDG_CACHE_HOME/binpose/convex, by default below ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(base) / "binpose" / "convex"


def _decompose(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> list[Part]:
    """CoACD on the mesh scaled to unit size, so that its tolerances mean the same for a screw and a crate."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if len(faces) > MAX_INPUT_FACES:
        mesh = mesh.simplify_quadric_decimation(face_count=MAX_INPUT_FACES)
    center, size = mesh.bounds.mean(0), float(mesh.extents.max())
    coacd.set_log_level("off")
    raw = coacd.run_coacd(
        coacd.Mesh((mesh.vertices - center) / size, mesh.faces),
        threshold=CONCAVITY,
        max_convex_hull=MAX_PARTS,
        decimate=True,
        max_ch_vertex=MAX_PART_VERTICES,
        seed=SEED,
    )
    parts = [(np.asarray(v, float) * size + center, np.asarray(f, np.int32)) for v, f in raw]
    if not parts:
        raise ValueError("it returned no part")
    return parts


def _hull(points: NDArray[np.float64]) -> Part:
    hull = trimesh.convex.convex_hull(points)
    return np.asarray(hull.vertices, float), np.asarray(hull.faces, np.int32)


def _cache_path(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> Path:
    key = f"{CACHE_VERSION} {version('coacd')} {CONCAVITY} {MAX_PARTS} {MAX_PART_VERTICES} {MAX_INPUT_FACES} {SEED}"
    digest = hashlib.sha256(key.encode())
    digest.update(np.ascontiguousarray(vertices, "<f8").tobytes())
    digest.update(np.ascontiguousarray(faces, "<i4").tobytes())
    return cache_folder() / f"{digest.hexdigest()[:32]}.npz"


def _read(path: Path) -> list[Part]:
    """The cached parts; none when there are none or the file is damaged."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            return [(archive[f"vertices_{i}"], archive[f"faces_{i}"]) for i in range(len(archive.files) // 2)]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return []


def _write(path: Path, parts: list[Part]) -> None:
    arrays: dict[str, Any] = {}
    for i, (vertices, faces) in enumerate(parts):
        arrays[f"vertices_{i}"], arrays[f"faces_{i}"] = vertices, faces
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **arrays)
