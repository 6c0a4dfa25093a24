"""The formats that trimesh reads for us, STL, glTF and STEP, and what it is silent about in them."""

from __future__ import annotations

import json
import logging
import re
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.meshes.mesh_file_error import MeshFileError

Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]

STL_HEADER = 84  # bytes; the last four count the facets
STL_FACET = 50  # bytes
HARMLESS_EXTENSIONS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_mesh_quantization")
TRIANGLES, TRIANGLE_STRIP, TRIANGLE_FAN = 4, 5, 6  # glTF's modes; those below draw points and lines
PIP_CASCADIO = "pip install 'binpose-evalkit[step]'"


def read_stl(data: bytes, path: Path) -> Mesh:
    """Vertices (3F, 3) and triangles (F, 3) of an STL file, every facet with corners of its own.

    Raises:
        MeshFileError: it is damaged.
    """
    count = int.from_bytes(data[STL_HEADER - 4 : STL_HEADER], "little")
    if STL_HEADER + STL_FACET * count <= len(data) and len(data) >= STL_HEADER and count:
        return _load(data[: STL_HEADER + STL_FACET * count], "stl")  # what follows is some program's own
    text = re.sub(rb"(?im)^\s*(end)?solid\b.*$", rb"\1solid", data)  # names may hold any of the format's words
    mesh = _load(text, "stl")
    if len(mesh[1]) != len(re.findall(rb"(?im)^\s*facet\b", text)):
        raise MeshFileError("not every facet has its three corners and every solid its end")
    return mesh


def read_gltf(data: bytes, path: Path) -> Mesh:
    """Vertices (V, 3) in meters and triangles (F, 3) of a glTF file's scene, every instance in its place.

    Raises:
        MeshFileError: it holds what trimesh leaves out or misreads.
    """
    binary = data[:4] == b"glTF"
    header = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")] if binary else data)
    _require_plain(header)
    return _load(data, "glb" if binary else "gltf", path)


def read_step(data: bytes, path: Path) -> Mesh:
    """Vertices (V, 3) in meters, as STEP states its unit, and triangles (F, 3) within 0.01 mm of the surfaces.

    Raises:
        MeshFileError: the extra is not installed, or it holds no solids or surfaces.
    """
    if find_spec("cascadio") is None:
        raise MeshFileError(f"reading STEP needs an extra: {PIP_CASCADIO}; or export the part as STL")
    with tempfile.TemporaryDirectory(prefix="binpose-step-") as folder:
        step_file, glb_file = Path(folder) / "part.step", Path(folder) / "part.glb"
        step_file.write_bytes(data)
        command = [sys.executable, "-m", "evalkit.meshes.step_process", str(step_file), str(glb_file)]
        subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True)
        if not glb_file.is_file():
            raise MeshFileError("it cannot be read as STEP, or holds no solids or surfaces")
        return _load(glb_file.read_bytes(), "glb")


def _load(data: bytes, kind: str, path: Path | None = None) -> Mesh:
    import trimesh  # here, since it takes a third of a second and most commands read no mesh

    with _silent_trimesh():
        resolver = None if path is None else trimesh.resolvers.FilePathResolver(str(path))
        mesh = trimesh.load_scene(BytesIO(data), file_type=kind, resolver=resolver, process=False).to_mesh()
    return np.array(mesh.vertices, float).reshape(-1, 3), np.array(mesh.faces, np.int64).reshape(-1, 3)


@contextmanager
def _silent_trimesh() -> Iterator[None]:
    """trimesh logs tracebacks of what it then raises; and takes numbers that cannot be read for the text's end."""
    log = logging.getLogger("trimesh")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.filterwarnings("error", message="string or file could not be read")
            yield
    finally:
        log.setLevel(level)


def _require_plain(header: dict[str, Any]) -> None:
    """Raise MeshFileError for what trimesh passes over in silence."""
    for name in header.get("extensionsRequired", []):
        if not str(name).startswith(HARMLESS_EXTENSIONS):
            raise MeshFileError(
                f"it needs the glTF extension '{str(name)[:40]}', which is not read here; export without"
            )
    accessors = header.get("accessors", [])
    for primitive in (p for mesh in header.get("meshes", []) for p in mesh.get("primitives", [])):
        if primitive.get("mode", TRIANGLES) == TRIANGLE_FAN:
            raise MeshFileError("it holds triangle fans, which are not read here; export plain triangles")
        read = [primitive.get("attributes", {}).get("POSITION"), primitive.get("indices")]
        for accessor in (accessors[i] for i in read if i is not None):
            if "sparse" in accessor:
                raise MeshFileError("it holds sparse accessors, which are not read here; export without compression")
            if accessor.get("normalized"):
                raise MeshFileError("its positions are normalized integers, which are not read here; export floats")
    for node in header.get("nodes", []):
        if "EXT_mesh_gpu_instancing" in node.get("extensions", {}):
            raise MeshFileError("it holds instances by EXT_mesh_gpu_instancing, which is not read here; export without")
        if "mesh" in node and "skin" in node:
            raise MeshFileError("it holds a skinned mesh, whose shape depends on a pose; export a rigid one")
