"""Meshes in 3MF packages (3MF Core Specification 1.3, with the Production Extension's parts in files of their own).

trimesh reads 3MF too, but of a part file that holds several objects it gives every component all of them.
"""

from __future__ import annotations

import posixpath
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from evalkit.meshes.mesh_file_error import MeshFileError

UNITS = {"micron": "micron", "millimeter": "mm", "centimeter": "cm", "inch": "inch", "foot": "foot", "meter": "m"}
CORE = "http://schemas.microsoft.com/3dmanufacturing/core/"
UNDERSTOOD = (CORE, "http://schemas.microsoft.com/3dmanufacturing/production/",
              "http://schemas.microsoft.com/3dmanufacturing/material/")  # fmt: skip
ROOT_TYPE = "/3dmodel"  # how the type of the package's relationship to its root model ends
SUPPORTS = ("support", "solidsupport")  # printed to hold the part, and broken off

Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]
Key = tuple[str, str]  # a model file in the package, and an object's id there


@dataclass
class _Object:
    """A mesh, or other objects with the affine transforms (4, 3) of rows that place them."""

    kind: str
    mesh: Mesh | None = None
    components: list[tuple[Key, NDArray[np.float64]]] = field(default_factory=list)


class _Package:
    """Objects and build items of all model files, read as they are asked for."""

    def __init__(self, data: bytes) -> None:
        self._archive = zipfile.ZipFile(BytesIO(data))
        self._names = {"/" + name.lower(): name for name in self._archive.namelist()}
        self._models: set[str] = set()
        self.objects: dict[Key, _Object] = {}
        self.items: list[tuple[Key, NDArray[np.float64]]] = []
        self.unit = ""
        self.root = self._root_name()
        self.open_model(self.root)

    def open_model(self, name: str) -> None:
        """Add the objects of a model file, and the root's build items and unit."""
        if name in self._models:
            return
        self._models.add(name)
        if name not in self._names:
            raise MeshFileError(f"its package lacks the file '{name}'")
        namespaces: dict[str, str] = {}
        for event, element in ElementTree.iterparse(
            BytesIO(self._archive.read(self._names[name])), events=("start-ns", "start", "end")
        ):
            if event == "start-ns":
                namespaces[element[0]] = element[1]
            elif event == "start" and _tag(element) == "model":
                _require_understood(element.get("requiredextensions", ""), namespaces)
                self.unit = self.unit or element.get("unit", "millimeter")
            elif event == "end" and _tag(element) == "object":
                self.objects[name, element.get("id", "")] = _read_object(element, name)
                element.clear()
            elif event == "end" and _tag(element) == "item" and name == self.root:
                self.items.append((_reference(element, name), _transform(element)))

    def _root_name(self) -> str:
        relations = self._names.get("/_rels/.rels")
        if relations is not None:
            for element in ElementTree.fromstring(self._archive.read(relations)):
                if element.get("Type", "").lower().endswith(ROOT_TYPE):
                    return posixpath.join("/", element.get("Target", "")).lower()
        return "/3d/3dmodel.model"


def read_3mf(data: bytes) -> tuple[Mesh, str]:
    """Vertices (V, 3) and triangles (F, 3) of everything that a 3MF package builds, and its unit.

    Raises:
        MeshFileError: it is no 3MF package, needs an extension that is not read here, or an object contains itself.
    """
    try:
        package = _Package(data)
        meshes = [mesh for key, transform in package.items for mesh in _placed(package, key, transform, ())]
    except (zipfile.BadZipFile, ElementTree.ParseError, KeyError, ValueError, EOFError, RuntimeError):
        raise MeshFileError("it is no 3MF package, or is damaged") from None
    if package.unit not in UNITS:
        raise MeshFileError(f"its unit '{package.unit[:20]}' is not one of 3MF's")
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    vertices = [np.zeros((0, 3)), *(vertices for vertices, _ in meshes)]
    faces = [np.zeros((0, 3), np.int64), *(faces + start for (_, faces), start in zip(meshes, starts, strict=False))]
    return (np.concatenate(vertices), np.concatenate(faces)), UNITS[package.unit]


def _placed(package: _Package, key: Key, transform: NDArray[np.float64], inside: tuple[Key, ...]) -> Iterator[Mesh]:
    """The meshes of an object and of its components, in the frame that `transform` leads to."""
    if key in inside:
        raise MeshFileError(f"its object {key[1]} contains itself")
    package.open_model(key[0])
    found = package.objects[key]
    if found.kind in SUPPORTS:
        return
    if found.mesh is not None:
        vertices, faces = found.mesh
        mirrored = np.linalg.det(transform[:3]) < 0
        yield vertices @ transform[:3] + transform[3], faces[:, ::-1] if mirrored else faces
    for part, own in found.components:
        together = np.concatenate([own[:3] @ transform[:3], own[3:] @ transform[:3] + transform[3]])
        yield from _placed(package, part, together, (*inside, key))


def _read_object(element: ElementTree.Element, model: str) -> _Object:
    found = _Object(element.get("type", "model"))
    for child in element:
        if _tag(child) == "mesh":
            found.mesh = _read_mesh(child)
        elif _tag(child) == "components":
            found.components = [(_reference(part, model), _transform(part)) for part in child]
    return found


def _read_mesh(element: ElementTree.Element) -> Mesh:
    vertices = [[float(v.attrib[axis]) for axis in "xyz"] for v in element.iterfind("{*}vertices/{*}vertex")]
    faces = [[int(t.attrib[v]) for v in ("v1", "v2", "v3")] for t in element.iterfind("{*}triangles/{*}triangle")]
    corners = np.array(faces, np.int64).reshape(-1, 3)
    if corners.min(initial=0) < 0 or corners.max(initial=-1) >= len(vertices):
        raise MeshFileError("a face names a vertex that the file lacks")
    return np.array(vertices, float).reshape(-1, 3), corners


def _reference(element: ElementTree.Element, model: str) -> Key:
    """The object that a component or an item names; by the production extension it may lie in another file."""
    path = next((value for name, value in element.attrib.items() if name.endswith("}path")), model)
    return posixpath.join("/", path).lower(), element.attrib["objectid"]


def _transform(element: ElementTree.Element) -> NDArray[np.float64]:
    """Affine transform (4, 3) of row vectors."""
    numbers = element.get("transform", "1 0 0 0 1 0 0 0 1 0 0 0").split()
    return np.array(numbers, float).reshape(4, 3)


def _require_understood(prefixes: str, namespaces: dict[str, str]) -> None:
    for prefix in prefixes.split():
        if not namespaces.get(prefix, "").startswith(UNDERSTOOD):
            raise MeshFileError(
                f"it needs the 3MF extension '{prefix[:20]}', which is not read here; export plain meshes"
            )


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]
