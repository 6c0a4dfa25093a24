"""Polygons to triangles. A fan, which trimesh and most readers cut, covers the notches of concave polygons."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evalkit.meshes.mesh_file_error import MeshFileError

AREA_TOLERANCE = 1e-6  # of a polygon's area: triangles that cover more or less than this are not a triangulation
FLAT = 1e-9  # of a polygon's squared area: a corner turned backwards by less is a straight one
THIN = 1e-5  # of a triangle's longest side: one of less height lies on a straight side, up to float32's rounding


class Polygons(NamedTuple):
    """Polygons of any number of corners.

    Attributes:
        counts: corners of each (P,).
        corners: vertex indices of all (sum of counts,), one polygon after the other.
    """

    counts: NDArray[np.int64]
    corners: NDArray[np.int64]

    @classmethod
    def joined(cls, several: list[Polygons]) -> Polygons:
        """All of them, in order."""
        return cls(np.concatenate([p.counts for p in several]), np.concatenate([p.corners for p in several]))


def triangulate(vertices: NDArray[np.float64], polygons: Polygons) -> NDArray[np.int64]:
    """Triangles (F, 3) that cover simple polygons, convex or not, planar or nearly so, in the polygons' order.

    Every corner stays a corner, the straight ones too, so that neighbors still meet edge to edge. No triangle lies on
    a straight side if that can be helped: the neighbor's would lie on it too, and pass for a repeated face.

    Raises:
        MeshFileError: a polygon names a vertex that is not there, or crosses itself.
    """
    counts, corners = polygons
    if len(corners) and (corners.min() < 0 or corners.max() >= len(vertices)):
        raise MeshFileError("a face names a vertex that the file lacks")
    starts = np.cumsum(counts) - counts
    pieces: list[NDArray[np.int64]] = [np.zeros((0, 3), np.int64)]
    order: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
    for sides in np.unique(counts[counts >= 3]):
        chosen = np.flatnonzero(counts == sides)
        triangles = _triangulate_alike(vertices, corners[starts[chosen, None] + np.arange(sides)])
        pieces.append(triangles.reshape(-1, 3))
        order.append(np.repeat(chosen, sides - 2))
    return np.concatenate(pieces)[np.argsort(np.concatenate(order), kind="stable")]


def _triangulate_alike(vertices: NDArray[np.float64], corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles (P, n - 2, 3) of polygons (P, n) that have equally many corners."""
    middle = np.arange(1, corners.shape[1] - 1)
    fans = np.stack([np.broadcast_to(corners[:, :1], (len(corners), len(middle))), corners[:, middle]], -1)
    fans = np.concatenate([fans, corners[:, middle + 1, None]], -1)
    if corners.shape[1] == 3:
        return fans
    with np.errstate(invalid="ignore", over="ignore"):  # vertices that are not finite are refused later
        a, b, c = np.moveaxis(vertices[fans], 2, 0)
        normals = np.cross(b - a, c - a)  # (P, n - 2, 3)
        total = normals.sum(1)
        along = np.einsum("pfi,pi->pf", normals, total)
        folded = (along < -FLAT * np.einsum("pi,pi->p", total, total)[:, None]).any(1)
        longest = np.max([((b - a) ** 2).sum(-1), ((c - b) ** 2).sum(-1), ((a - c) ** 2).sum(-1)], axis=0)
        thin = (np.linalg.norm(normals, axis=-1) < THIN * longest).any(1) & total.any(1)
    for i in np.flatnonzero(folded | thin):
        try:
            fans[i] = corners[i][_triangulate_concave(vertices[corners[i]], total[i])]
        except MeshFileError:
            if folded[i]:
                raise
    return fans


def _triangulate_concave(points: NDArray[np.float64], normal: NDArray[np.float64]) -> NDArray[np.int64]:
    """Triangles (n - 2, 3) of a polygon's corners (n, 3), cut in the coordinate plane that `normal` faces most."""
    import manifold3d

    axis = int(np.abs(normal).argmax())
    flat = points[:, [(axis + 1) % 3, (axis + 2) % 3]]
    flat = flat - flat.mean(0)
    if normal[axis] < 0:  # the library takes counter-clockwise outlines
        flat = flat[:, ::-1]
    triangles = np.asarray(manifold3d.triangulate([flat], allow_convex=False), np.int64)
    a, b, c = np.moveaxis(flat[triangles], 1, 0)
    area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum()
    if len(triangles) != len(points) - 2 or abs(area - abs(normal[axis])) > AREA_TOLERANCE * area:
        raise MeshFileError(f"a face of {len(points)} corners crosses itself, so it encloses no certain area")
    return triangles
