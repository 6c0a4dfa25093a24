"""Foreign things put into a scene that has come to rest: let down from above until they touch what is there.

They are no instances and have no labels: they belong to the background, and hide what lies behind them. They are let
down as they are turned, without tipping over; what lies on one point of a heap may look as if it were held.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from evalkit.geometry import poses
from simgen.config_sections import BinSize

if TYPE_CHECKING:
    from simgen.objects.foreign_things import Thing

DISTRACTOR_STAGE = 9  # second word of the spawn key; drops, viewpoints, bins and sensors use others
CELLS = 40  # of the height map in an object's diameter
POINTS = 12_000  # on a surface
STRETCH = (0.85, 1.2)  # sizes of scalable things
HIGHEST = 1.2  # object diameters above the walls that a thing may reach
MOST = 3.0  # times the expected number

Array = NDArray[np.float64]
Mesh = tuple[Array, NDArray[np.int32]]


def put_distractors(
    things: Sequence[Thing],
    share: float,
    mesh: tuple[ArrayLike, NDArray[np.integer]],
    world_from_obj: Array,
    size: BinSize,
    diameter: float,
    seed: int,
    scene: int,
) -> list[Mesh]:
    """Foreign things among the instances of a scene; what would reach too high is left out.

    Args:
        share: of all that lies there, on average.
        mesh: of the object, meters.
        world_from_obj: (n, 4, 4) poses at rest.
        diameter: of the object, meters.

    Returns:
        (vertices (V, 3), faces (F, 3)) in the world, meters.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(scene, DISTRACTOR_STAGE)))
    expected = len(world_from_obj) * share / (1 - share)
    count = min(int(rng.poisson(expected)), math.ceil(MOST * expected))
    ground = _HeightMap(size, diameter / CELLS)
    points = _surface_points((np.asarray(mesh[0], float), np.asarray(mesh[1], np.int32)), rng)
    for pose in world_from_obj:
        ground.raise_to(poses.apply(pose, points))
    put: list[Mesh] = []
    for _ in range(count):
        thing = things[int(rng.integers(len(things)))]
        vertices = thing.vertices * (rng.uniform(*STRETCH) if thing.scalable else 1.0)
        turned = poses.compose(vertices, _lying(thing, vertices, rng).T)
        middle = (turned.min(0) + turned.max(0)) / 2
        place = rng.uniform(-0.5, 0.5, 2) * (size.width, size.depth)
        turned += np.append(place - middle[:2], -turned[:, 2].min())
        points = _surface_points((turned, thing.faces), rng)
        lift = np.array([0.0, 0.0, ground.clearance(points)])
        if (turned[:, 2] + lift[2]).max() > size.height + HIGHEST * diameter:
            continue
        ground.raise_to(points + lift)
        put.append((turned + lift, thing.faces))
    return put


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [part + start for (_, part), start in zip(meshes, first[:-1], strict=True)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces).astype(np.int32)


class _HeightMap:
    """How high what lies on the ground reaches, cell by cell; the bin's walls included."""

    def __init__(self, size: BinSize, cell: float) -> None:
        self._cell, self._half = cell, 2.0 * max(size.width, size.depth)
        count = min(math.ceil(2 * self._half / cell), 2000)
        self._cell = 2 * self._half / count
        self._height = np.zeros((count, count))
        if size.walls:
            middle = (np.arange(count) + 0.5) * self._cell - self._half
            inside = (np.abs(middle[:, None]) < size.width / 2) & (np.abs(middle) < size.depth / 2)
            self._height[~inside] = size.height

    def _cells(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        index = np.clip(((points[:, :2] + self._half) / self._cell).astype(np.int64), 0, len(self._height) - 1)
        return index[:, 0], index[:, 1]

    def raise_to(self, points: Array) -> None:
        """Put a surface's points (n, 3) on the map."""
        np.maximum.at(self._height, self._cells(points), points[:, 2])

    def clearance(self, points: Array) -> float:
        """By how much a surface's points (n, 3) must rise, or may sink if negative, to just touch what is there."""
        return float((self._height[self._cells(points)] - points[:, 2]).max())


def _lying(thing: Thing, vertices: Array, rng: np.random.Generator) -> Array:
    """A rotation (3, 3): about the vertical, after the thing was laid on a side of its hull, large ones more often."""
    turn = poses.from_axis_angle([0.0, 0.0, 1.0], rng.uniform(-math.pi, math.pi))
    if thing.upright:
        return turn
    hull = ConvexHull(vertices, qhull_options="QJ")
    corners = vertices[hull.simplices]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    normal = hull.equations[rng.choice(len(areas), p=areas / areas.sum()), :3]
    return poses.compose(turn, poses.rotation_between(normal, [0.0, 0.0, -1.0]))


def _surface_points(mesh: Mesh, rng: np.random.Generator) -> Array:
    """Points (POINTS + V, 3) spread over a surface, its vertices among them."""
    vertices, faces = mesh
    a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    picked = rng.choice(len(faces), POINTS, p=areas / areas.sum())
    s, t = rng.random((2, POINTS, 1))
    fold = s + t > 1
    s, t = np.where(fold, 1 - s, s), np.where(fold, 1 - t, t)
    return np.concatenate([vertices, a[picked] + s * (b - a)[picked] + t * (c - a)[picked]])
