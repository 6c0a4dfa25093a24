"""What a pose would look like: an object's depth and normals in the part of an image that it covers, by embreex."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel

Array = NDArray[np.float64]
NEAR = 1e-3  # meters; an object that reaches nearer is at no camera's working distance


@dataclass(frozen=True, eq=False)
class Traced:
    """The m pixels of an image whose rays meet the object, every `stride`-th of its rows and columns.

    Attributes:
        u, v: (m,) column and row.
        depth: (m,) meters along the camera's axis.
        normal: (m, 3) unit normals toward the camera, in its frame.
        outside: how many more pixels of the silhouette lie beyond the image's edges.
    """

    u: NDArray[np.int64]
    v: NDArray[np.int64]
    depth: Array
    normal: Array
    outside: int
    stride: int

    def __len__(self) -> int:
        return len(self.depth)


class RayTracer:
    """Traces rays of cameras through one object.

    Raises:
        InputError: the model has no mesh, or embreex is not installed.
    """

    def __init__(self, model: ObjectModel) -> None:
        try:
            from embreex import rtcore_scene
            from embreex.mesh_construction import TriangleMesh
        except ImportError:
            raise InputError("tracing rays needs the package embreex: pip install embreex.") from None
        vertices, faces = model.mesh
        self._box = _corners(vertices[np.unique(faces)])
        self._center = self._box.mean(0)
        corners = (vertices - self._center)[faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
        self._scene = rtcore_scene.EmbreeScene(robust=True)
        self._mesh = TriangleMesh(self._scene, corners.astype(np.float32))  # the scene does not keep it alive

    def trace(self, cam_from_obj: Array, camera: Camera, most: int = 1 << 14) -> Traced:
        """The object at a pose (4, 4) as `camera` sees it, by at most about `most` rays."""
        rectangle = self._rectangle(cam_from_obj, camera)
        if rectangle is None:
            nothing = np.zeros(0, np.int64)
            return Traced(nothing, nothing, np.zeros(0), np.zeros((0, 3)), 0, 1)
        x0, y0, x1, y1 = rectangle
        stride = max(1, int(np.ceil(np.sqrt((x1 - x0) * (y1 - y0) / most))))
        v, u = (grid.ravel() for grid in np.mgrid[y0:y1:stride, x0:x1:stride])
        rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))], -1)
        obj_from_cam = poses.invert(np.asarray(cam_from_obj, float))
        # Rays start beside the object, so that float32 keeps its precision however far the camera is.
        start = self._depth_before(cam_from_obj)
        directions = rays @ obj_from_cam[:3, :3].T
        origins = obj_from_cam[:3, 3] - self._center + start * directions
        found = self._scene.run(origins.astype(np.float32), directions.astype(np.float32), output=True)
        hit = found["primID"] >= 0
        depth = start + np.asarray(found["tfar"], float)[hit]
        normal = self._normals[found["primID"][hit]] @ np.asarray(cam_from_obj, float)[:3, :3].T
        away = np.einsum("nk,nk->n", normal, rays[hit]) > 0
        normal[away] *= -1.0  # faces may be wound either way, and open surfaces be seen from behind
        u, v = u[hit], v[hit]
        inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        return Traced(u[inside], v[inside], depth[inside], normal[inside], int((~inside).sum()), stride)

    def _depth_before(self, cam_from_obj: Array) -> float:
        """Meters along the camera's axis where rays may start: just before the object's box."""
        corners = poses.apply(np.asarray(cam_from_obj, float), self._box)
        return float(max(corners[:, 2].min() * 0.999, NEAR))

    def _rectangle(self, cam_from_obj: Array, camera: Camera) -> tuple[int, int, int, int] | None:
        """x0, y0, x1, y1 of the pixels that may show the object, some beyond the image; None where it shows nothing."""
        corners = poses.apply(np.asarray(cam_from_obj, float), self._box)
        if not corners[:, 2].min() > NEAR:
            return None
        pixels = camera.project(corners)
        low, high = np.floor(pixels.min(0)).astype(int), np.ceil(pixels.max(0)).astype(int) + 1
        if (low >= [camera.width, camera.height]).any() or (high <= 0).any():
            return None
        edge = max(camera.width, camera.height)  # beyond it, what lies outside is not counted on
        x0, y0 = np.maximum(low, -edge)
        x1, y1 = np.minimum(high, [camera.width + edge, camera.height + edge])
        return int(x0), int(y0), int(x1), int(y1)


def _corners(points: Array) -> Array:
    """The eight corners (8, 3) of the box around points."""
    low, high = points.min(0), points.max(0)
    return np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
