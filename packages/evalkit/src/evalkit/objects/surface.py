"""How far points are from an object's surface: fast by a voxel grid, fine by nearest samples and their planes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from evalkit.geometry.principal_axes import principal_axes
from evalkit.geometry.small_systems import solve_positive
from evalkit.objects.model import sample_surface_with_normals, surface_moments

Array = NDArray[np.float64]
SAMPLES = 40_000
NEIGHBORS = 4
NEAR = 0.15  # of the bounding radius: beyond, a distance to about COARSE samples' spacing will do
COARSE = 3000  # samples that distances beyond NEAR are measured to
LEAF = 32  # samples of a leaf of the tree: the fastest for some ten thousand queries at a time
GRID_CELLS = 96
ROUGHNESS_RADIUS = 0.06  # of the bounding radius: several faces of a fine mesh, and less than a feature
FACES = 36  # of the mesh, about as many as it takes to see how rough a place is
FEWEST, MOST = 24, 120  # samples about a place: more would reach around a thin tube, whose curvature is no roughness
PROBES = 400  # places where the roughness is looked at


@dataclass(frozen=True, eq=False)
class Surface:
    """A dense sample of a surface about its area centroid, in units of the bounding radius (half the diameter).

    Attributes:
        radius: meters of that unit.
        centroid: (3,) meters.
        points, normals: (n, 3) each, uniform over the area; in random order, so that any slice is a sample too.
        spacing: mean distance of neighboring samples.
        covariance: (3, 3) second moments of the whole surface, exactly.
        faces: of the mesh, how many.
    """

    radius: float
    centroid: Array
    points: Array
    normals: Array
    spacing: float
    covariance: Array
    faces: int

    @classmethod
    def from_mesh(cls, vertices: ArrayLike, faces: ArrayLike, count: int = SAMPLES) -> Surface:
        """From a triangle mesh with some area: vertices (V, 3), faces (F, 3)."""
        vertices, faces = np.asarray(vertices, float), np.asarray(faces)
        area, centroid, covariance = surface_moments(vertices, faces)
        radius = float(np.linalg.norm(vertices[np.unique(faces)] - centroid, axis=1).max())
        points, normals = sample_surface_with_normals(vertices, faces, count)
        shuffled = np.random.default_rng(0).permutation(count)
        return cls(
            radius=radius,
            centroid=centroid,
            points=(points[shuffled] - centroid) / radius,
            normals=normals[shuffled],
            spacing=float(np.sqrt(area / count)) / radius,
            covariance=covariance / radius**2,
            faces=len(faces),
        )

    def distance(self, points: ArrayLike) -> Array:
        """Distance (n,) of points (n, 3) to the surface.

        The distance to the plane of a near sample, plus whatever the point lies aside of that sample beyond the
        sample spacing: exact on flat and gently curved parts, at most a spacing too small elsewhere.
        """
        return self.nearest(points)[0]

    def nearest(self, points: ArrayLike) -> tuple[Array, Array, Array]:
        """Distance (n,), signed distance to the nearest sample's plane (n,), and that plane's normal (n, 3)."""
        points = np.asarray(points, float)
        index = self._near_samples(points)
        offset = points[:, None] - self.points[index]
        along = np.einsum("nki,nki->nk", offset, self.normals[index])
        aside = np.sqrt(np.maximum((offset**2).sum(-1) - along**2, 0.0))
        distance = np.hypot(along, np.maximum(aside - self.spacing, 0.0))
        best = distance.argmin(1)
        rows = np.arange(len(points))
        return distance[rows, best], along[rows, best], self.normals[index[rows, best]]

    def _near_samples(self, points: Array) -> NDArray[np.intp]:
        """Indices (n, NEIGHBORS) of the samples nearest to the points (n, 3); coarsely for points far off.

        A tree's search takes ten times as long for a point far off as for one near the surface.
        """
        _, index = self._tree.query(points, NEIGHBORS, distance_upper_bound=NEAR)
        index = np.where(index == len(self.points), index[:, :1], index)
        far = np.flatnonzero(index[:, 0] == len(self.points))
        index[far] = self._coarse_tree.query(points[far])[1][:, None]
        return np.asarray(index)

    @cached_property
    def roughness(self) -> float:
        """How far the surface strays from smooth where it is smoothest: the noise of a scan, and zero for a clean mesh.

        A fifth of all places are at most this far (root mean square) from their best quadric. Noise is everywhere;
        edges and teeth have plain flanks between them.
        """
        count = int(np.clip(FACES * len(self.points) / self.faces, FEWEST, MOST))
        reach, index = self._tree.query(self.points[:PROBES], count, distance_upper_bound=ROUGHNESS_RADIUS)
        index[np.isinf(reach)] = 0
        facing = np.einsum("pi,pki->pk", self.normals[:PROBES], self.normals[index])
        used = np.isfinite(reach) & (facing > 0.3)  # not a thin wall's other face
        enough = used.sum(1) > 12
        return float(np.quantile(_off_quadric(self.points[index[enough]], used[enough]), 0.2)) if enough.any() else 0.0

    def rough_distance(self, points: ArrayLike) -> NDArray[np.float32]:
        """Distance (...) of points (..., 3) within the unit ball, to about a cell: 2 % of the radius."""
        cells = self._cells(np.asarray(points, float))
        return self._grid[cells[..., 0], cells[..., 1], cells[..., 2]]

    def _cells(self, points: Array) -> NDArray[np.intp]:
        half = GRID_CELLS // 2
        return np.clip((points * (half - 2) + half).astype(np.intp), 0, GRID_CELLS - 1)

    @cached_property
    def _grid(self) -> NDArray[np.float32]:
        empty = np.ones((GRID_CELLS,) * 3, bool)
        empty[tuple(self._cells(self.points).T)] = False
        return np.asarray(distance_transform_edt(empty) / (GRID_CELLS // 2 - 2), np.float32)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.points, LEAF)

    @cached_property
    def _coarse_tree(self) -> cKDTree:
        return cKDTree(self.points[:COARSE], LEAF)


def _off_quadric(points: Array, used: NDArray[np.bool_]) -> Array:
    """Root mean square distance (p,) of those `used` (p, k) of the points (p, k, 3) from their best quadric.

    The quadric stands over the points' mean plane.
    """
    weight, count = used[..., None].astype(float), used.sum(1)
    offset = weight * (points - (weight * points).sum(1, keepdims=True) / count[:, None, None])
    size = np.sqrt((offset**2).sum((1, 2)) / count)
    offset /= size[:, None, None]
    moments = np.einsum("pki,pkj->pij", offset, offset)
    axes = np.array([principal_axes(matrix)[1] for matrix in moments])
    height, u, v = np.moveaxis(np.einsum("pki,pij->pkj", offset, axes), -1, 0)
    terms = weight * np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], -1)
    tiny = 1e-9 * np.eye(6)  # points in a row fix no quadric
    best = solve_positive(np.einsum("pki,pkj->pij", terms, terms) + tiny, np.einsum("pki,pk->pi", terms, height))
    left = height - np.einsum("pki,pi->pk", terms, best)
    return size * np.sqrt((left**2).sum(1) / (count - 6))
