"""Convex parts of a mesh, for the physics: CoACD (Wei et al., SIGGRAPH 2022), kept on disk once computed."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import zipfile
import zlib
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from evalkit.atomic import atomic_path
from evalkit.errors import InputError
from evalkit.geometry.principal_axes import principal_axes
from simgen.objects.hulls import simplified_hull
from simgen.objects.mending import closed

Part = tuple[NDArray[np.float64], NDArray[np.int32]]
COACD_OPTIONS: dict[str, Any] = {
    "threshold": 0.15,  # concavity on a mesh of unit size: 8 parts for the bunny
    "max_convex_hull": 32,
    "decimate": False,  # it shrinks: of a ball 0.87 of the volume is left, 5 % of the diameter deep
    "mcts_iterations": 60,  # half of CoACD's time for the same parts
    "resolution": 1000,
    "seed": 0,
}
MAX_FACES = 5_000  # CoACD's time grows with them, the parts hardly change
AGGRESSIONS = (1, 2, 3)  # 7, the default, eats a quarter of a candlestick; 1 leaves a fine ball as it is
HULL_TOLERANCE = 0.005  # of the largest side: the parts' hulls, with fewer vertices, stay as near to the surface
THIN = 0.045  # of the largest side: thinner parts' hulls stay nearer, or a rod would be half as thick again
CRASHES = (-signal.SIGSEGV, -signal.SIGABRT, -signal.SIGFPE, -signal.SIGILL, -signal.SIGBUS)
CACHE_VERSION = 5


class ConvexPartsError(Exception):
    """CoACD gave no parts; the message says why."""


def convex_parts(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> tuple[list[Part], list[str]]:
    """Convex parts that together follow the surface, each (vertices (V, 3), faces (F, 3)), and warnings.

    The same for the same mesh, on a busy machine too. Where CoACD crashes on it, the one convex hull of everything.

    Raises:
        InputError: CoACD was stopped, as by lack of memory, so what it would have given is not known.
    """
    path, warnings = _cache_path(vertices, faces), list[str]()
    parts = _read(path)
    if parts:
        return parts, warnings
    try:
        parts = _decompose(vertices, faces)
    except ConvexPartsError as error:
        warnings.append(
            f"The mesh could not be split into convex parts ({error}); its convex hull stands in, so the physics "
            "fills its hollows."
        )
        return [_hull(vertices)], warnings
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


def _decompose(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> list[Part]:
    """CoACD on the mesh scaled to unit size, so that its tolerances mean the same for a screw and a crate."""
    low, high = vertices.min(0), vertices.max(0)
    center, size = (low + high) / 2, float((high - low).max())
    parts = _run_coacd(_simplified((vertices - center) / size, faces))
    return [(points * size + center, triangles) for points, triangles in map(_simplified_part, parts)]


def _simplified_part(part: Part) -> Part:
    """A part of a mesh of unit size with fewer vertices; a flat one stays as it is."""
    thinness = min(1.0, _thickness(part[0]) / THIN)
    points = simplified_hull(part[0], HULL_TOLERANCE * thinness**2)
    return part if points is part[0] else _hull(points)


def _thickness(points: NDArray[np.float64]) -> float:
    """The smallest extent of points (n, 3) along their principal axes."""
    centered = points - points.mean(0)
    axes = principal_axes(np.einsum("ni,nj->ij", centered, centered))[1]
    return float(np.ptp(np.einsum("ni,ij->nj", centered, axes), axis=0).min())


def _simplified(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> trimesh.Trimesh:
    """A closed mesh of MAX_FACES or, where so few would change the surface, some more."""
    mesh = trimesh.Trimesh(*closed(vertices, faces), process=False)
    if len(mesh.faces) <= MAX_FACES:
        return mesh
    for aggression in AGGRESSIONS:
        simple = mesh.simplify_quadric_decimation(face_count=MAX_FACES, aggression=aggression)
        if len(simple.faces) <= 2 * MAX_FACES and simple.is_watertight:
            break
    return simple


def _run_coacd(mesh: trimesh.Trimesh) -> list[Part]:
    """The parts of a mesh of unit size; see :mod:`simgen.objects.coacd_process`."""
    preprocess = "off" if mesh.is_watertight else "auto"  # remeshing a sound mesh costs a minute and rounds it
    options = json.dumps({**COACD_OPTIONS, "preprocess_mode": preprocess})
    with tempfile.TemporaryDirectory(prefix="binpose-convex-") as folder:
        mesh_file, parts_file = Path(folder) / "mesh.npz", Path(folder) / "parts.npz"
        np.savez(mesh_file, vertices=mesh.vertices, faces=mesh.faces)
        command = [sys.executable, "-m", "simgen.objects.coacd_process", str(mesh_file), str(parts_file), options]
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True)
        parts = _read(parts_file)
        if done.returncode < 0 and done.returncode not in CRASHES:
            raise InputError(
                f"CoACD was stopped by signal {-done.returncode}; decimate the mesh, or give it memory and time."
            )
        if not parts:
            raise ConvexPartsError(f"CoACD failed with exit code {done.returncode}")
    return parts


def _hull(points: NDArray[np.float64]) -> Part:
    hull = trimesh.convex.convex_hull(points)
    return np.asarray(hull.vertices, float), np.asarray(hull.faces, np.int32)


def _cache_path(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Path:
    key = f"{CACHE_VERSION} {version('coacd')} {MAX_FACES} {HULL_TOLERANCE} {THIN} {sorted(COACD_OPTIONS.items())}"
    digest = hashlib.sha256(key.encode())
    digest.update(np.ascontiguousarray(vertices, "<f8").tobytes())
    digest.update(np.ascontiguousarray(faces, "<i8").tobytes())
    return cache_folder() / f"{digest.hexdigest()[:32]}.npz"


def _read(path: Path) -> list[Part]:
    """The parts in a file; none where it is missing or damaged."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            parts = [(archive[f"vertices_{i}"], archive[f"faces_{i}"]) for i in range(len(archive.files) // 2)]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return []
    return parts if all(_is_part(*part) for part in parts) else []


def _is_part(vertices: NDArray[Any], faces: NDArray[Any]) -> bool:
    if not (vertices.ndim == faces.ndim == 2 and vertices.shape[1] == faces.shape[1] == 3 and len(vertices) > 3):
        return False
    return bool(np.isfinite(vertices).all() and np.all((faces >= 0) & (faces < len(vertices))))


def _write(path: Path, parts: list[Part]) -> None:
    arrays: dict[str, Any] = {}
    for i, (vertices, faces) in enumerate(parts):
        arrays[f"vertices_{i}"], arrays[f"faces_{i}"] = vertices, faces
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **arrays)
