"""Depth images on the CPU: a z-buffer that draws every instance once, into a window of its own, then composites.

Because an instance is alone in its window, its whole silhouette is counted on the way, the part that others hide and
the part beyond the frame included; that is what visibility needs, at no second rendering.

Pixels are sampled at their centers. Vertices are snapped to 1/4096 pixel and edges tested in integers with the top-left
rule, so that neighboring triangles neither leave a gap nor share a pixel. Depth is that of the triangle's plane on
the pixel's ray: 1/z is affine in the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from simgen.compiled import compiled
from simgen.rendering.outward import faces_outward
from simgen.rendering.triangles import GUARD, draw_clipped, draw_tame

BEYOND_FRAME = 1  # what is larger than the frame is counted this many frames beyond each border
NEAR_PER_EXTENT = 1e-3  # near plane, as a share of the mesh's extent
NOTHING = (np.zeros((0, 3)), np.zeros((0, 3), np.int32))  # a mesh without faces


@dataclass(frozen=True, eq=False)
class Rendering:
    """What one camera sees.

    Attributes:
        depth: (height, width) axial meters, 0 where there is nothing.
        instance_id: (height, width) row of the instance + 1, 0 for background and nothing.
        pixels_full: (n,) pixels of each instance's whole silhouette.
        box_full: (n, 4) its x0, y0, x1, y1; zeros if it has no pixel.
    """

    depth: NDArray[np.float32]
    instance_id: NDArray[np.uint16]
    pixels_full: NDArray[np.int32]
    box_full: NDArray[np.int32]


class Rasterizer:
    """Renders instances of one mesh before a static background.

    Args:
        camera: the intrinsics.
        vertices, faces: (V, 3) in meters, object frame, and (F, 3).
        background: vertices (B, 3) in meters, world frame, and faces (G, 3), drawn with id 0; nothing if left out.
    """

    def __init__(
        self,
        camera: Camera,
        vertices: NDArray[np.float64],
        faces: NDArray[np.int32],
        background: tuple[NDArray[np.float64], NDArray[np.int32]] = NOTHING,
    ) -> None:
        self._camera = camera
        self._intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        self._vertices, self._faces = _as_mesh(vertices, faces)
        self.set_background(*background)
        self._cull = faces_outward(vertices, faces)
        low, high = self._vertices.min(0), self._vertices.max(0)
        self._middle, self._radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
        self._near = NEAR_PER_EXTENT * self._radius
        rows, columns = (side * (1 + 2 * BEYOND_FRAME) for side in (camera.height, camera.width))
        self._window = np.zeros((rows, columns), np.float32)

    def set_background(self, vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> None:
        """Put another background, as the constructor takes it, behind all instances from now on."""
        self._background = _as_mesh(vertices, faces)

    def render(self, cam_from_obj: NDArray[np.float64], cam_from_world: NDArray[np.float64]) -> Rendering:
        """One frame: poses of the instances (n, 4, 4) and of the world (4, 4)."""
        height, width, count = self._camera.height, self._camera.width, len(cam_from_obj)
        nearness, ids = np.zeros((height, width), np.float32), np.zeros((height, width), np.uint16)
        pixels_full, box_full = np.zeros(count, np.int32), np.zeros((count, 4), np.int32)
        frame = (0, 0, width, height)
        draw_clipped(*self._background, cam_from_world, self._intrinsics, self._near, False, frame, nearness)
        for row in range(count):
            box = self._draw_instance(np.ascontiguousarray(cam_from_obj[row]))
            pixels_full[row] = _composite(self._window, box, row + 1, nearness, ids, box_full[row])
        return Rendering(_inverted(nearness), ids, pixels_full, box_full)

    def _draw_instance(self, cam_from_obj: NDArray[np.float64]) -> tuple[int, int, int, int]:
        """Draw one instance into the empty window; the part of the image it lies in."""
        aside, above = BEYOND_FRAME * self._camera.width, BEYOND_FRAME * self._camera.height
        window = (-aside, -above, self._camera.width + aside, self._camera.height + above)
        mesh = (self._vertices, self._faces, cam_from_obj, self._intrinsics)
        if self._needs_clipping(cam_from_obj):
            return draw_clipped(*mesh, self._near, self._cull, window, self._window)
        return draw_tame(*mesh, self._cull, window, self._window)

    def _needs_clipping(self, cam_from_obj: NDArray[np.float64]) -> bool:
        """Whether the sphere around the mesh reaches behind the near plane or out of the guard band."""
        x, y, z = poses.apply(cam_from_obj, self._middle[None])[0]
        nearest = z - self._radius
        if nearest < self._near:
            return True
        fx, fy, cx, cy = self._intrinsics
        aside = max(fx * (abs(x) + self._radius) / nearest + abs(cx), fy * (abs(y) + self._radius) / nearest + abs(cy))
        return bool(aside > GUARD)


def _as_mesh(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
    """Contiguous copies: one type each for the compiled code; unsigned, for numba checks signed indices' sign."""
    return np.array(vertices, np.float64, order="C"), np.array(faces, np.uint32, order="C")


@compiled
def _composite(window, box, identity, nearness, ids, box_full):  # type: ignore[no-untyped-def]
    """Count the window's silhouette, empty it, and put what is nearest into the frame; its pixels."""
    height, width = nearness.shape
    x0, y0, x1, y1 = box[2], box[3], box[0], box[1]
    total = 0
    for v in range(box[1], box[3]):
        for u in range(box[0], box[2]):
            value = window[v - box[1], u - box[0]]
            if value > 0:
                window[v - box[1], u - box[0]] = 0
                total += 1
                x0, y0, x1, y1 = min(x0, u), min(y0, v), max(x1, u + 1), max(y1, v + 1)
                if 0 <= u < width and 0 <= v < height and value > nearness[v, u]:
                    nearness[v, u] = value
                    ids[v, u] = identity
    if total > 0:
        box_full[0], box_full[1], box_full[2], box_full[3] = x0, y0, x1, y1
    return total


@compiled
def _inverted(nearness):  # type: ignore[no-untyped-def]
    depth = np.zeros_like(nearness)
    for v in range(nearness.shape[0]):
        for u in range(nearness.shape[1]):
            if nearness[v, u] > 0:
                depth[v, u] = 1 / nearness[v, u]
    return depth
