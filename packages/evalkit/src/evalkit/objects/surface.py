"""How far points are from an object's surface: fast by a voxel grid, fine by nearest samples and their planes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from evalkit.geometry.principal_axes import principal_axes
from evalkit.objects.model import sample_surface_with_normals, surface_moments

Array = NDArray[np.float64]
SAMPLES = 40_000
NEIGHBORS = 4
GRID_CELLS = 96
ROUGHNESS_RADIUS = 0.06  # of the bounding radius: several faces of a fine mesh, and less than a feature
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
    """

    radius: float
    centroid: Array
    points: Array
    normals: Array
    spacing: float
    covariance: Array

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
        _, index = self._tree.query(points, NEIGHBORS)
        offset = points[:, None] - self.points[index]
        along = np.einsum("nki,nki->nk", offset, self.normals[index])
        aside = np.sqrt(np.maximum((offset**2).sum(-1) - along**2, 0.0))
        distance = np.hypot(along, np.maximum(aside - self.spacing, 0.0))
        best = distance.argmin(1)
        rows = np.arange(len(points))
        return distance[rows, best], along[rows, best], self.normals[index[rows, best]]

    @cached_property
    def roughness(self) -> float:
        """How far the surface strays from smooth where it is smoothest: the noise of a scan, and zero for a clean mesh.

        A fifth of all places are at most this far (root mean square) from their best quadric. Noise is everywhere;
        edges and teeth have plain flanks between them.
        """
        strays = []
        for probe, index in enumerate(self._tree.query_ball_point(self.points[:PROBES], ROUGHNESS_RADIUS)):
            same_side = self.normals[index] @ self.normals[probe] > 0.3  # not a thin wall's other face
            points = self.points[index][same_side]
            if len(points) > 12:
                strays.append(_off_quadric(points))
        return float(np.quantile(strays, 0.2)) if strays else 0.0

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
        return cKDTree(self.points)


def _off_quadric(points: Array) -> float:
    """Root mean square distance of `points` (n, 3) from the quadric fitted over their mean plane."""
    offset = points - points.mean(0)
    axes = principal_axes(np.einsum("ni,nj->ij", offset, offset))[1]
    height, u, v = (offset @ axes).T
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], -1)
    left = height - terms @ np.linalg.lstsq(terms, height, rcond=None)[0]
    return float(np.sqrt((left**2).sum() / (len(left) - 6)))
