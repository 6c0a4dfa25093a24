"""Depth images on the CPU: a z-buffer that draws every instance once, into a window of its own, then composites.

Because an instance is alone in its window, its whole silhouette is counted on the way, the part that others hide and
the part beyond the frame included; that is what visibility needs, at no second rendering.

Pixels are sampled at their centres. Vertices are snapped to 1/256 pixel and edges tested in integers with the top-left
rule, so that neighbouring triangles neither leave a gap nor share a pixel. Depth is that of the triangle's plane on
the pixel's ray: 1/z is affine in the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from evalkit.camera import Camera
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

SUBPIXEL = 256
GUARD = float(1 << 17)  # pixels; triangles are clipped there, so that the edge functions stay within 64 bits
BEYOND_FRAME = 1  # windows reach this many frames beyond each border; nothing sane is larger
NEAR_PER_EXTENT = 1e-3  # near plane, as a share of the mesh's extent


@dataclass(frozen=True, eq=False)
class Rendering:
    """What one camera sees.

    Attributes:
        depth: (height, width) axial metres, 0 where there is nothing.
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
        vertices, faces: (V, 3) in metres, object frame, and (F, 3).
        background: vertices (B, 3) in metres, world frame, and faces (G, 3); drawn with id 0.
    """

    def __init__(
        self,
        camera: Camera,
        vertices: NDArray[np.float64],
        faces: NDArray[np.int32],
        background: tuple[NDArray[np.float64], NDArray[np.int32]],
    ) -> None:
        self._camera = camera
        self._intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        self._vertices, self._faces = np.ascontiguousarray(vertices, float), np.ascontiguousarray(faces, np.int32)
        self._background = np.ascontiguousarray(background[0], float), np.ascontiguousarray(background[1], np.int32)
        self._cull = faces_outward(self._vertices, self._faces)
        self._near = NEAR_PER_EXTENT * float(np.ptp(vertices, axis=0).max())
        rows, columns = (side * (1 + 2 * BEYOND_FRAME) for side in (camera.height, camera.width))
        self._window = np.zeros((rows, columns), np.float32)

    def render(self, cam_from_obj: NDArray[np.float64], cam_from_world: NDArray[np.float64]) -> Rendering:
        """One frame: poses of the instances (n, 4, 4) and of the world (4, 4)."""
        height, width, count = self._camera.height, self._camera.width, len(cam_from_obj)
        nearness, ids = np.zeros((height, width), np.float32), np.zeros((height, width), np.uint16)
        pixels_full, box_full = np.zeros(count, np.int32), np.zeros((count, 4), np.int32)
        _draw_mesh(
            *self._background, cam_from_world, self._intrinsics, self._near, False, (0, 0, width, height), nearness
        )
        for row in range(count):
            box = _draw_mesh(
                self._vertices, self._faces, cam_from_obj[row], self._intrinsics, self._near, self._cull,
                (-BEYOND_FRAME * width, -BEYOND_FRAME * height, (1 + BEYOND_FRAME) * width, (1 + BEYOND_FRAME) * height),
                self._window,
            )  # fmt: skip
            pixels_full[row] = _composite(self._window, box, row + 1, nearness, ids, box_full[row])
        return Rendering(_inverted(nearness), ids, pixels_full, box_full)


def faces_outward(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> bool:
    """Whether every component is closed and consistently wound, normals out, so that back faces are never seen."""
    _, merged = np.unique(vertices, axis=0, return_inverse=True)
    merged = merged.reshape(-1)[faces].astype(np.int64)
    edges = np.concatenate([merged[:, [0, 1]], merged[:, [1, 2]], merged[:, [2, 0]]])
    forward, backward = edges @ [len(vertices), 1], edges @ [1, len(vertices)]
    once = np.unique(forward)
    if len(once) != len(forward) or not np.array_equal(once, np.sort(backward)):
        return False
    graph = coo_matrix((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), shape=(len(vertices),) * 2)
    _, component = connected_components(graph, directed=False)
    volume = np.linalg.det(vertices[faces] - vertices.mean(0))
    return bool((np.bincount(component[merged[:, 0]], volume)[np.unique(component[merged[:, 0]])] > 0).all())


@numba.njit(cache=True, nogil=True)
def _draw_mesh(vertices, faces, cam_from_mesh, intrinsics, near, cull, window, out):  # type: ignore[no-untyped-def]
    """Draw 1/z of a mesh into `out`, whose [0, 0] is the corner of the returned box, which lies within `window`."""
    fx, fy, cx, cy = intrinsics
    count = len(vertices)
    points, snapped = np.empty((count, 3)), np.empty((count, 2), np.int64)
    tame = np.empty(count, np.bool_)
    x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
    all_tame = True
    for i in range(count):
        for k in range(3):
            points[i, k] = (
                cam_from_mesh[k, 0] * vertices[i, 0] + cam_from_mesh[k, 1] * vertices[i, 1]
                + cam_from_mesh[k, 2] * vertices[i, 2] + cam_from_mesh[k, 3]
            )  # fmt: skip
        z = points[i, 2]
        tame[i] = False
        if z >= near:
            u, v = fx * points[i, 0] / z + cx, fy * points[i, 1] / z + cy
            if abs(u) <= GUARD and abs(v) <= GUARD:
                tame[i] = True
                snapped[i, 0], snapped[i, 1] = round(u * SUBPIXEL), round(v * SUBPIXEL)
                x0, y0, x1, y1 = min(x0, u), min(y0, v), max(x1, u), max(y1, v)
        all_tame = all_tame and tame[i]
    if not all_tame:  # something lies behind the camera or far aside: the box is unknown
        x0, y0, x1, y1 = -np.inf, -np.inf, np.inf, np.inf
    box = (
        int(max(window[0], np.floor(x0))), int(max(window[1], np.floor(y0))),
        int(min(window[2], np.floor(x1) + 2)), int(min(window[3], np.floor(y1) + 2)),
    )  # fmt: skip
    if box[0] >= box[2] or box[1] >= box[3]:
        return (0, 0, 0, 0)
    polygon = np.empty((16, 3))
    corners = np.empty((16, 2), np.int64)
    for face in range(len(faces)):
        a, b, c = faces[face]
        if tame[a] and tame[b] and tame[c]:
            _fill_triangle(
                points[a], points[b], points[c], snapped[a], snapped[b], snapped[c], intrinsics, cull, box, out
            )
            continue
        size = _clip(points[a], points[b], points[c], intrinsics, near, polygon)
        for i in range(size):
            corners[i, 0] = round((fx * polygon[i, 0] / polygon[i, 2] + cx) * SUBPIXEL)
            corners[i, 1] = round((fy * polygon[i, 1] / polygon[i, 2] + cy) * SUBPIXEL)
        for i in range(1, size - 1):
            _fill_triangle(
                polygon[0], polygon[i], polygon[i + 1], corners[0], corners[i], corners[i + 1],
                intrinsics, cull, box, out,
            )  # fmt: skip
    return box


@numba.njit(cache=True, nogil=True)
def _fill_triangle(p, q, r, a, b, c, intrinsics, cull, box, out):  # type: ignore[no-untyped-def]
    """Keep the larger 1/z of `out` and triangle p, q, r (camera frame), which the snapped corners a, b, c cover."""
    ax, ay, bx, by, dx, dy = a[0], a[1], b[0], b[1], c[0], c[1]
    area = (bx - ax) * (dy - ay) - (dx - ax) * (by - ay)
    if area == 0 or (cull and area > 0):  # rows go down, so outward faces turn the other way
        return
    if area < 0:
        bx, by, dx, dy = dx, dy, bx, by
    u0, u1 = max(box[0], -(-min(ax, bx, dx) // SUBPIXEL)), min(box[2] - 1, max(ax, bx, dx) // SUBPIXEL)
    v0, v1 = max(box[1], -(-min(ay, by, dy) // SUBPIXEL)), min(box[3] - 1, max(ay, by, dy) // SUBPIXEL)
    if u0 > u1 or v0 > v1:
        return
    per_u, per_v, constant = _nearness_plane(p, q, r, intrinsics)
    low = min(1 / p[2], 1 / q[2], 1 / r[2])
    high = max(1 / p[2], 1 / q[2], 1 / r[2])
    row_ab, row_bd, row_da = (
        _edge(ax, ay, bx, by, u0, v0), _edge(bx, by, dx, dy, u0, v0), _edge(dx, dy, ax, ay, u0, v0)
    )  # fmt: skip
    for v in range(v0, v1 + 1):
        e_ab, e_bd, e_da = row_ab, row_bd, row_da
        line = constant + per_v * v
        for u in range(u0, u1 + 1):
            if (e_ab | e_bd | e_da) >= 0:
                nearness = np.float32(min(max(line + per_u * u, low), high))
                if nearness > out[v - box[1], u - box[0]]:
                    out[v - box[1], u - box[0]] = nearness
            e_ab -= (by - ay) * SUBPIXEL
            e_bd -= (dy - by) * SUBPIXEL
            e_da -= (ay - dy) * SUBPIXEL
        row_ab += (bx - ax) * SUBPIXEL
        row_bd += (dx - bx) * SUBPIXEL
        row_da += (ax - dx) * SUBPIXEL


@numba.njit(cache=True, nogil=True)
def _edge(ax, ay, bx, by, u, v):  # type: ignore[no-untyped-def]
    """Twice the area of a, b and the centre of pixel (u, v); a pixel on the edge belongs to top and left edges only."""
    value = (bx - ax) * (v * SUBPIXEL - ay) - (by - ay) * (u * SUBPIXEL - ax)
    return value if by < ay or (by == ay and bx > ax) else value - 1


@numba.njit(cache=True, nogil=True)
def _nearness_plane(p, q, r, intrinsics):  # type: ignore[no-untyped-def]
    """1/z of the plane through three points as (per u, per v, constant); that of the nearest point if seen edge-on."""
    fx, fy, cx, cy = intrinsics
    e0, e1, e2 = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    f0, f1, f2 = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    n0, n1, n2 = e1 * f2 - e2 * f1, e2 * f0 - e0 * f2, e0 * f1 - e1 * f0
    offset = n0 * p[0] + n1 * p[1] + n2 * p[2]
    if offset == 0.0:
        return 0.0, 0.0, 1 / min(p[2], q[2], r[2])
    per_u, per_v = n0 / (fx * offset), n1 / (fy * offset)
    return per_u, per_v, n2 / offset - per_u * cx - per_v * cy


@numba.njit(cache=True, nogil=True)
def _clip(a, b, c, intrinsics, near, polygon):  # type: ignore[no-untyped-def]
    """Cut a triangle at the near plane and at the guard band (Sutherland and Hodgman 1974); corners left."""
    fx, fy, cx, cy = intrinsics
    planes = np.array([
        [0.0, 0.0, 1.0, -near],
        [fx, 0.0, cx + GUARD, 0.0], [-fx, 0.0, GUARD - cx, 0.0],
        [0.0, fy, cy + GUARD, 0.0], [0.0, -fy, GUARD - cy, 0.0],
    ])  # fmt: skip
    polygon[0], polygon[1], polygon[2] = a, b, c
    size, before = 3, np.empty_like(polygon)
    for plane in planes:
        before[:size] = polygon[:size]
        kept = 0
        for i in range(size):
            here, after = before[i], before[(i + 1) % size]
            inside = plane[0] * here[0] + plane[1] * here[1] + plane[2] * here[2] + plane[3]
            inside_after = plane[0] * after[0] + plane[1] * after[1] + plane[2] * after[2] + plane[3]
            if inside >= 0:
                polygon[kept] = here
                kept += 1
            if (inside >= 0) != (inside_after >= 0):
                polygon[kept] = here + (after - here) * (inside / (inside - inside_after))
                kept += 1
        size = kept
    return size


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True)
def _inverted(nearness):  # type: ignore[no-untyped-def]
    depth = np.zeros_like(nearness)
    for v in range(nearness.shape[0]):
        for u in range(nearness.shape[1]):
            if nearness[v, u] > 0:
                depth[v, u] = 1 / nearness[v, u]
    return depth
