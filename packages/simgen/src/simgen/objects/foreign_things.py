"""Things that lie among the parts and are none: other parts, packing, a gripper's finger, cables, or files of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import fast_simplification
import numpy as np
from numpy.typing import NDArray

from evalkit.atomic import sha256_of_file
from evalkit.errors import InputError
from evalkit.meshes.read import read_file_mesh
from evalkit.meshes.units import METERS, decide_units
from simgen.config_sections import DistractorConfig
from simgen.objects.builtin import BUILTIN_OBJECTS

BUILTIN = "builtin"
MOST_FACES = 1500  # of one thing: more are not seen in depth, and each is drawn in every view
SHAPE_SEED = 5  # of the shapes of packing and cables, which are the same in every dataset
SIZES = (0.7, 1.2)  # of the part's diameter, between which the built-in parts among it are

Array = NDArray[np.float64]
Mesh = tuple[Array, NDArray[np.int32]]


@dataclass(frozen=True, eq=False)
class Thing:
    """A foreign thing: vertices (V, 3) in meters and faces (F, 3).

    `upright` things stand or lie as they are, z up; others lie on any side. `scalable` ones come in several sizes.
    """

    name: str
    vertices: Array
    faces: NDArray[np.int32]
    upright: bool = False
    scalable: bool = True


def parse_distractors(text: str, share: float) -> DistractorConfig:
    """``builtin``, mesh files, or both, separated by commas.

    Raises:
        InputError: a file is missing.
    """
    sources = tuple(part.strip() for part in text.split(","))
    for source in sources:
        if source != BUILTIN and not Path(source).is_file():
            raise InputError(
                f"--distractors {source}: no such file; give {BUILTIN}, or mesh files with commas between."
            )
    hashes = tuple("" if source == BUILTIN else sha256_of_file(Path(source)) for source in sources)
    return DistractorConfig(sources, hashes, share)


def things_of(config: DistractorConfig, part: str, diameter: float) -> list[Thing]:
    """The things of a config.

    Args:
        part: name of the object that they are foreign to, which is not among the built-in ones.
        diameter: of that object, meters, which the built-in things suit.

    Raises:
        InputError: a file is missing, no mesh, or not what it was when the config was made.
    """
    found: list[Thing] = []
    for source, sha256 in zip(config.sources, config.sha256, strict=True):
        found.extend(_builtin(part, diameter) if source == BUILTIN else [_from_file(source, sha256)])
    return found


def _from_file(source: str, sha256: str) -> Thing:
    path = Path(source)
    if not path.is_file() or sha256_of_file(path) != sha256:
        raise InputError(f"--distractors {source}: the file is missing or has changed; put back what it was.")
    mesh = read_file_mesh(path)
    vertices = np.asarray(mesh.vertices, float)[np.unique(mesh.faces)]
    unit, _, _ = decide_units("auto", float(np.ptp(vertices, axis=0).max()), path.suffix.lstrip("."), source, mesh.unit)
    return Thing(path.stem, *_simple(mesh.vertices * METERS[unit], mesh.faces), scalable=False)


def _builtin(part: str, diameter: float) -> Iterator[Thing]:
    rng = np.random.default_rng(SHAPE_SEED)
    names = [name for name in BUILTIN_OBJECTS if name not in ("bunny", part)]
    for name, size in zip(names, np.linspace(*SIZES, len(names)), strict=True):
        vertices, faces = BUILTIN_OBJECTS[name].make()
        extent = float(np.linalg.norm(np.ptp(vertices, axis=0)))
        yield Thing(name, *_simple(vertices * (size * diameter / extent), faces))
    for number in range(2):
        yield Thing(f"crumpled sheet {number}", *_sheet(rng, 1.1 * diameter), upright=True)
        yield Thing(f"peanut {number}", *_tube(_bow(0.35 * diameter, 0.3 + number), 0.12 * diameter))
    yield Thing("gripper finger", *_box(0.18 * diameter, 0.25 * diameter, 1.2 * diameter), upright=True)
    yield Thing("carton", *_box(0.9 * diameter, 0.6 * diameter, 0.4 * diameter))
    for number in range(2):
        yield Thing(f"cable {number}", *_tube(_winding(rng, 2.5 * diameter), 0.035 * diameter), upright=True)


def _simple(vertices: Array, faces: NDArray[np.integer]) -> Mesh:
    if len(faces) > MOST_FACES:
        vertices, faces = fast_simplification.simplify(
            np.asarray(vertices, np.float64), np.asarray(faces, np.int32), target_count=MOST_FACES
        )
    return np.asarray(vertices, float), np.asarray(faces, np.int32)


def _box(x: float, y: float, z: float) -> Mesh:
    corners = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)], float) * (x, y, z)
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
             [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip
    return corners, np.array(faces, np.int32)


def _sheet(rng: np.random.Generator, side: float, cells: int = 16) -> Mesh:
    """A crumpled sheet of film or paper: folds of random directions and wavelengths."""
    y, x = np.mgrid[: cells + 1, : cells + 1] / cells
    height = np.zeros_like(x)
    for _ in range(6):
        direction, waves, phase = rng.uniform(0, np.pi), rng.uniform(1.0, 4.0), rng.uniform(0, 1)
        along = x * np.cos(direction) + y * np.sin(direction)
        height += rng.uniform(0.04, 0.12) * np.abs(2 * ((along * waves + phase) % 1) - 1)
    vertices = np.stack([x, y * rng.uniform(0.6, 1.0), height - height.min()], -1).reshape(-1, 3) * side
    here = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    quads = np.stack([here, here + 1, here + cells + 2, here + cells + 1], -1)
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)


def _bow(length: float, bend: float) -> Array:
    """Points (n, 3) of a short arc."""
    angle = np.linspace(-bend, bend, 8) * np.pi / 2
    radius = length / (bend * np.pi)
    return np.column_stack([radius * np.sin(angle), radius * (1 - np.cos(angle)), np.zeros_like(angle)])


def _winding(rng: np.random.Generator, length: float, points: int = 40) -> Array:
    """Points (n, 3) of a curve that winds over the ground and rises here and there."""
    turn = np.cumsum(rng.normal(0, 0.35, points)) * 0.5
    step = length / points
    plan = np.cumsum(step * np.column_stack([np.cos(turn), np.sin(turn)]), axis=0)
    rise = 0.04 * length * (1 + np.sin(np.linspace(0, rng.uniform(4, 9), points)))
    return np.column_stack([plan - plan.mean(0), rise])


def _tube(curve: Array, radius: float, sides: int = 10) -> Mesh:
    """A tube about a curve (n, 3), closed at both ends."""
    tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.cross(tangent, [0.0, 0.0, 1.0])
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    up = np.cross(across, tangent)
    angle = np.arange(sides) * 2 * np.pi / sides
    rings = curve[:, None] + radius * (
        np.cos(angle)[None, :, None] * across[:, None] + np.sin(angle)[None, :, None] * up[:, None]
    )
    count = len(curve)
    k, s = (index.ravel() for index in np.mgrid[: count - 1, :sides])
    a, b, c, d = k * sides + s, k * sides + (s + 1) % sides, (k + 1) * sides + (s + 1) % sides, (k + 1) * sides + s
    ends = [[base + 0, base + i, base + i + 1] for base in (0, (count - 1) * sides) for i in range(1, sides - 1)]
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1), np.array(ends)])
    return rings.reshape(-1, 3), faces.astype(np.int32)
