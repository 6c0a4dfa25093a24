"""What an object is: geometry, size, symmetry, and how far off a pose may be."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.principal_axes import principal_axes
from evalkit.objects.outside import seen_from_outside
from evalkit.objects.symmetry import Symmetry

Array = NDArray[np.float64]
THRESHOLD_RATIO = 0.1
SAMPLE_POINTS = 1000
LEAST_SPREAD = 1e-3  # diameters that a surface spreads from its centroid, however few of it lies far from it


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A rigid object in its own frame, in meters.

    Attributes:
        name: empty where nobody named it.
        diameter: of the smallest sphere around the area *centroid* (Brégier et al. 2017), not the minimal sphere.
        centroid: (3,) area-weighted centroid of the surface.
        inertial_from_obj: (4, 4) to the frame at the centroid whose axes are the surface covariance's.
        lam: (3, 3) square root of the area-weighted surface covariance, in the inertial frame.
        symmetry: proper symmetry group, in the object's frame, about the centroid.
        threshold: a pose within this Sym distance of the truth counts as true.
        points: (n, 3) a fixed, area-weighted sample of the surface.
        vertices: (V, 3) all vertices of the mesh, where they are known.
        faces: (F, 3) the mesh's triangles, where they are known; made by :meth:`from_mesh`, those seen from outside.
    """

    name: str
    diameter: float
    centroid: Array
    inertial_from_obj: Array
    lam: Array
    symmetry: Symmetry
    threshold: float
    points: Array | None = None
    vertices: Array | None = None
    faces: NDArray[np.int32] | None = None
    notes: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def from_mesh(
        cls, name: str, vertices: ArrayLike, faces: ArrayLike, symmetry: Symmetry | None = None, **notes: Any
    ) -> ObjectModel:
        """From a triangle mesh: vertices (V, 3) in meters, faces (F, 3).

        What cannot be seen from outside, inner bodies and cavities, is left out.

        Raises:
            InputError: the mesh has no surface.
        """
        vertices, faces = np.asarray(vertices, float), np.asarray(faces, np.int32)
        faces = faces[seen_from_outside(vertices, faces)]
        area, centroid, covariance = surface_moments(vertices, faces)
        if not area > 0:
            raise InputError(f"object '{name}': the mesh has no surface area.")
        variances, axes = principal_axes(covariance)
        used = vertices[np.unique(faces)]
        diameter = 2.0 * float(np.linalg.norm(used - centroid, axis=1).max())
        return cls(
            name=name,
            diameter=diameter,
            centroid=centroid,
            inertial_from_obj=poses.invert(poses.from_rotation_translation(axes, centroid)),
            lam=np.diag(np.sqrt(np.maximum(variances, 0.0))),
            symmetry=symmetry or Symmetry.parse("none"),
            threshold=THRESHOLD_RATIO * diameter,
            points=sample_surface(vertices, faces, SAMPLE_POINTS),
            vertices=vertices,
            faces=faces,
            notes=notes,
        )

    @property
    def title(self) -> str:
        """The name to show a reader."""
        return self.name or "the object"

    @property
    def mesh(self) -> tuple[Array, NDArray[np.int32]]:
        """Vertices (V, 3) and faces (F, 3).

        Raises:
            InputError: the mesh is not at hand.
        """
        if self.vertices is None or self.faces is None:
            raise InputError(f"object '{self.title}' has no mesh; give a file that holds it, or its mesh.")
        return self.vertices, self.faces

    @cached_property
    def finite_vertices(self) -> Array:
        """The vertices (n, 3) without those that are no numbers, which a file may hold as long as no face uses them."""
        vertices = np.zeros((0, 3)) if self.vertices is None else self.vertices
        return vertices[np.isfinite(vertices).all(-1)]

    @cached_property
    def lam_in_obj(self) -> Array:
        """Lambda (3, 3) with its axes in the object's frame, as the geometrically right Sym distance wants it."""
        turn = self.inertial_from_obj[:3, :3]
        return np.asarray(turn.T @ self.lam @ turn)

    def representatives(self, cam_from_obj: ArrayLike) -> Array:
        """Sym representatives of poses (..., 4, 4) -> (..., n, d), in meters; see :class:`Symmetry`."""
        cam_from_obj = np.asarray(cam_from_obj, float)
        return self.symmetry.representatives(cam_from_obj[..., :3, :3], self.centers(cam_from_obj), self.lam_in_obj)

    def centers(self, cam_from_obj: ArrayLike) -> Array:
        """The centroid in the camera's frame: poses (..., 4, 4) -> (..., 3)."""
        return poses.apply(cam_from_obj, self.centroid[None])[..., 0, :]

    @cached_property
    def box_center(self) -> Array | None:
        """Center (3,) of the box around the mesh's vertices; None where they are not known."""
        vertices = self.finite_vertices
        return (vertices.min(0) + vertices.max(0)) / 2 if len(vertices) else None

    @property
    def reference(self) -> dict[str, Any]:
        """What preds.json says of the object that its poses are of."""
        center = None if self.box_center is None else self.box_center.tolist()
        return {"name": self.name, "diameter": self.diameter, "box_center": center}

    def with_origin(self, origin: ArrayLike) -> ObjectModel:
        """The same object in a frame with the same axes whose origin is the point `origin` (3,) of this one."""
        shift = np.asarray(origin, float)
        back = poses.from_rotation_translation(np.eye(3), shift)
        return replace(
            self,
            centroid=self.centroid - shift,
            inertial_from_obj=self.inertial_from_obj @ back,
            points=None if self.points is None else self.points - shift,
            vertices=None if self.vertices is None else self.vertices - shift,
        )

    def with_symmetry(self, symmetry: Symmetry) -> ObjectModel:
        return replace(self, symmetry=symmetry)

    def to_json(self) -> dict[str, Any]:
        """Everything but the mesh; gt.json adds its vertices."""
        return {
            "name": self.name or None,
            "diameter": self.diameter,
            "centroid": self.centroid.tolist(),
            "inertial_from_obj": self.inertial_from_obj.tolist(),
            "lambda": self.lam.tolist(),
            "symmetry": self.symmetry.to_json(),
            "threshold": self.threshold,
            "points": None if self.points is None else np.round(self.points, 9).tolist(),
            "notes": self.notes,
        }

    @classmethod
    def from_json(cls, document: Any, where: str = "object") -> ObjectModel:
        """Read what :meth:`to_json` writes, with "vertices" where they are given.

        Raises:
            InputError: a field is missing, of the wrong shape, or not finite.
        """
        if not isinstance(document, dict):
            raise InputError(f"{where}: expected an object with name, diameter, centroid, lambda, symmetry …")
        frame = _numbers(document, "inertial_from_obj", (4, 4), where)
        if not poses.is_rotation(frame[:3, :3]):
            raise InputError(f"{where}: 'inertial_from_obj' must hold a rotation.")
        diameter, threshold = (float(_numbers(document, key, (), where)) for key in ("diameter", "threshold"))
        if diameter <= 0 or threshold <= 0:
            raise InputError(f"{where}: 'diameter' and 'threshold' must be positive meters.")
        points, vertices = (
            None if document.get(key) is None else _numbers(document, key, (-1, 3), where)
            for key in ("points", "vertices")
        )
        notes = document.get("notes")
        model = cls(
            name=str(document.get("name") or ""),
            diameter=diameter,
            centroid=_numbers(document, "centroid", (3,), where),
            inertial_from_obj=frame,
            lam=_numbers(document, "lambda", (3, 3), where),
            symmetry=Symmetry.from_json(document.get("symmetry"), f"{where}: symmetry"),
            threshold=threshold,
            points=points,
            vertices=vertices,
            notes=notes if isinstance(notes, dict) else {},
        )
        model.require_one_unit(where)
        return model

    def require_one_unit(self, where: str) -> None:
        """Refuse lengths that cannot belong together: some may be millimeters.

        The root mean square distance of the surface from its centroid, which Lambda holds, and that of any point are at
        most half the diameter; the threshold is a part of it.

        Raises:
            InputError: they differ from that by more than any rounding.
        """
        spread = float(np.linalg.norm(self.lam))
        farthest = [
            float(np.linalg.norm(some - self.centroid, axis=1).max())
            for some in (self.points, self.vertices)
            if some is not None
        ]
        lengths = {"threshold": self.threshold, "lambda": spread, "points or vertices": max([0.0, *farthest])}
        wrong = next((name for name, length in lengths.items() if length > self.diameter), None)
        if wrong is not None or spread < LEAST_SPREAD * self.diameter:
            raise InputError(
                f"{where}: its {wrong or 'lambda'} and its diameter of {self.diameter:g} m cannot be of one object; "
                "give all of them in meters."
            )


def surface_moments(vertices: ArrayLike, faces: ArrayLike) -> tuple[float, Array, Array]:
    """Exact area, centroid (3,) and area-weighted covariance (3, 3) of a triangle surface."""
    corners = np.asarray(vertices, float)[np.asarray(faces)]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    area = float(areas.sum())
    if not area > 0:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    centroid = np.einsum("f,fi->i", areas, corners.mean(1)) / area
    centered = corners - centroid
    sums = centered.sum(1)
    second = np.einsum("f,fki,fkj->ij", areas, centered, centered) + np.einsum("f,fi,fj->ij", areas, sums, sums)
    return area, centroid, second / (12.0 * area)


def sample_surface(vertices: ArrayLike, faces: ArrayLike, count: int, seed: int = 0) -> Array:
    """`count` points (count, 3), uniform over the surface; the same for the same mesh and seed."""
    return sample_surface_with_normals(vertices, faces, count, seed)[0]


def sample_surface_with_normals(
    vertices: ArrayLike, faces: ArrayLike, count: int, seed: int = 0
) -> tuple[Array, Array]:
    """The points (count, 3) of :func:`sample_surface` and the unit normals (count, 3) of the faces they lie on."""
    corners = np.asarray(vertices, float)[np.asarray(faces)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    rng = np.random.default_rng(seed)
    cumulative = np.cumsum(areas)
    strata = (np.arange(count) + rng.random(count)) / count * cumulative[-1]
    face = np.minimum(np.searchsorted(cumulative, strata), len(areas) - 1)
    a, b = rng.random((2, count, 1))
    outside = a + b > 1
    a, b = np.where(outside, 1 - a, a), np.where(outside, 1 - b, b)
    chosen = corners[face]
    points = chosen[:, 0] + a * (chosen[:, 1] - chosen[:, 0]) + b * (chosen[:, 2] - chosen[:, 0])
    return points, normals[face] / areas[face, None]


def _numbers(document: dict[str, Any], key: str, shape: tuple[int, ...], where: str) -> Array:
    try:
        array = np.array(document[key], dtype=float)
    except KeyError:
        raise InputError(f"{where}: the field '{key}' is missing.") from None
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: the field '{key}' must hold numbers only.") from None
    fits = array.ndim == len(shape) and all(want in (-1, have) for want, have in zip(shape, array.shape, strict=True))
    if not fits or not np.isfinite(array).all():
        raise InputError(f"{where}: the field '{key}' must hold finite numbers of shape {shape}.")
    return array
