"""The object as physics wants it: convex hulls about its center of mass, scaled to a size that the engine likes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry import poses
from evalkit.geometry.principal_axes import principal_axes

Array = NDArray[np.float64]
DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if sum(map(abs, d)) in (1, 3)])  # of a cube
Part = tuple[NDArray[np.float64], NDArray[np.int32]]


@dataclass(frozen=True, eq=False)
class Body:
    """The object as physics wants it: hulls about its center of mass, scaled.

    Attributes:
        hulls: (V_i, 3) vertices of each convex part, in simulated meters about the center of mass.
        center_of_mass: (3,) in the object's frame, meters.
        outermost: (k, 3) vertices that lie outermost in all directions: of a rod those of its ends, and none off its
            axis, which would go far where it only turns about itself.
        radius: of the sphere around the center of mass that holds all hulls, simulated meters.
        scale: simulated meters per meter.
        thickness: of the thinnest hull, over the diameter 2 `radius`.
    """

    hulls: list[Array]
    center_of_mass: Array
    outermost: Array
    radius: float
    scale: float
    thickness: float

    @classmethod
    def from_parts(cls, parts: list[Part], simulated_diameter: float) -> Body:
        """From convex parts (vertices (V, 3), faces (F, 3)) in meters, object frame."""
        center = center_of_mass(parts)
        radius = max(float(np.linalg.norm(vertices - center, axis=1).max()) for vertices, _ in parts)
        scale = simulated_diameter / (2 * radius)
        hulls = [(np.asarray(vertices, float) - center) * scale for vertices, _ in parts]
        vertices = np.concatenate(hulls)
        outermost = vertices[np.unique([_along(vertices, direction).argmax() for direction in DIRECTIONS])]
        return cls(hulls, center, outermost, radius * scale, scale, min(map(_thickness, hulls)) / simulated_diameter)


def _along(vertices: Array, direction: Array) -> Array:
    """How far vertices (V, 3) lie along a direction (3,): in a fixed order, without BLAS."""
    x, y, z = vertices.T
    return np.asarray(x * direction[0] + y * direction[1] + z * direction[2])


def _thickness(hull: Array) -> float:
    """The least extent of vertices (V, 3) along their principal axes."""
    offset = hull - hull.mean(0)
    _, axes = principal_axes(np.einsum("vi,vj->ij", offset, offset))
    return float(np.ptp(poses.compose(offset, axes), axis=0).min())


def center_of_mass(parts: list[Part]) -> Array:
    """Volume-weighted centroid (3,) of convex parts; of their surfaces' vertices where they are flat."""
    volumes, centroids = zip(*(_volume_and_centroid(*part) for part in parts), strict=True)
    if sum(volumes) <= 0:
        return np.asarray(np.concatenate([vertices for vertices, _ in parts]).mean(0))
    return np.average(np.array(centroids), axis=0, weights=np.array(volumes))


def _volume_and_centroid(vertices: Array, faces: NDArray[np.int32]) -> tuple[float, Array]:
    middle = vertices.mean(0)
    corners = vertices[faces] - middle
    a, b, c = np.moveaxis(corners, 1, 0)
    volumes = np.abs((np.cross(a, b) * c).sum(1)) / 6  # the middle is inside: the part is convex
    total = float(volumes.sum())
    if total <= 0:
        return 0.0, middle
    return total, middle + np.einsum("f,fki->i", volumes, corners) / (4 * total)
