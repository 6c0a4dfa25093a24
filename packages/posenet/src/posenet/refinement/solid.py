"""How deep a point lies within an object, and by how much two posed objects interpenetrate.

Inside is what no camera outside can see: a point is as deep as it lies behind the surface in the view that shows most
of it. That needs no closed mesh, and the hollow of a cup is outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from evalkit.geometry import poses
from evalkit.objects.depth_views import DepthViews, sphere_directions
from evalkit.objects.model import ObjectModel
from posenet.refinement.icp import placed

Array = NDArray[np.float64]
CELLS = 32  # of the grid, a side
VIEWS, SIDE = 32, 96
DEEPEST = 8  # of the sampled points: so many are as deep as is said, or deeper


class Solid:
    """The inside of one object.

    Raises:
        ValueError: the model has no mesh.
    """

    def __init__(self, model: ObjectModel) -> None:
        if model.vertices is None or model.faces is None:
            raise ValueError("an inside needs the object's mesh")
        vertices = model.vertices[np.unique(model.faces)]
        self.middle = (vertices.min(0) + vertices.max(0)) / 2
        self.radius = float(np.linalg.norm(vertices - self.middle, axis=1).max())
        self.depth = _depth_below_surface((model.vertices - self.middle) / self.radius, model.faces) * self.radius


def interpenetration(
    solids: Sequence[Solid], part: NDArray[np.int64], cam_from_obj: Array, pairs: NDArray[np.int64], points: Array
) -> Array:
    """Meters (p,) by which each pair (p, 2) of poses (n, 4, 4) interpenetrates.

    `part` (n,) says which of k solids each pose is of, `points` (k, P, 3) are of their surfaces.
    """
    grids, middles = np.stack([solid.depth for solid in solids]), np.stack([solid.middle for solid in solids])
    radii = np.array([solid.radius for solid in solids])
    return np.asarray(_interpenetration(cam_from_obj, part, pairs, points, grids, middles, radii))


def close_pairs(centers: Array, reach: float) -> NDArray[np.int64]:
    """Pairs (p, 2), first before second, of centers (n, 3) that are nearer than `reach` to each other."""
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=2)
    return np.argwhere(np.triu(apart < reach, 1))


def _depth_below_surface(vertices: Array, faces: NDArray[np.integer]) -> NDArray[np.float32]:
    """Depths (CELLS, CELLS, CELLS), 0 outside, over the cube about the unit ball that holds the surface."""
    views = DepthViews(vertices, faces, SIDE)
    steps = np.linspace(-1.0, 1.0, CELLS)
    cells = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
    deep = np.full(len(cells), np.inf)
    for turn in poses.rotation_between(sphere_directions(VIEWS), [0.0, 0.0, 1.0]):
        seen = cells @ turn.T
        pixel = np.clip((seen[:, :2] * (SIDE - 2) / 2 + SIDE / 2).astype(int), 0, SIDE - 1)
        surface = views.from_both_ends(turn)[0][pixel[:, 1], pixel[:, 0]]
        deep = np.minimum(deep, seen[:, 2] - surface)
    return np.asarray(np.maximum(deep, 0.0).reshape(CELLS, CELLS, CELLS), np.float32)


@numba.njit(cache=True, parallel=True, fastmath=True)
def _interpenetration(pose: Any, part: Any, pairs: Any, points: Any, grids: Any, middles: Any, radii: Any) -> Any:
    deepest = np.zeros(len(pairs))
    for p in numba.prange(len(pairs)):
        i, j = pairs[p]
        a, b = part[i], part[j]
        deepest[p] = max(
            _deep_in(pose[i], pose[j], points[a], grids[b], middles[b], radii[b]),
            _deep_in(pose[j], pose[i], points[b], grids[a], middles[a], radii[a]),
        )
    return deepest


@numba.njit(cache=True, fastmath=True)
def _deep_in(pose: Any, other: Any, points: Any, grid: Any, middle: Any, radius: float) -> Any:
    """How deep the DEEPEST-th deepest of `points` at `pose` lies in what `grid` describes at `other`."""
    turn = other[:3, :3].T.copy() @ pose[:3, :3].copy()
    shift = other[:3, :3].T.copy() @ (pose[:3, 3] - other[:3, 3])
    best = np.zeros(DEEPEST)
    scale = (len(grid) - 1) / 2.0
    for k in range(len(points)):
        q = placed(turn, shift, points[k])
        x = int(np.floor(((q[0] - middle[0]) / radius + 1.0) * scale + 0.5))
        y = int(np.floor(((q[1] - middle[1]) / radius + 1.0) * scale + 0.5))
        z = int(np.floor(((q[2] - middle[2]) / radius + 1.0) * scale + 0.5))
        if x < 0 or y < 0 or z < 0 or x >= len(grid) or y >= len(grid) or z >= len(grid):
            continue
        deep = grid[x, y, z]
        if deep > best[0]:  # keeps the least of them first
            at = 0
            while at + 1 < DEEPEST and best[at + 1] < deep:
                best[at] = best[at + 1]
                at += 1
            best[at] = deep
    return best[0]
