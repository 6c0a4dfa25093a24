"""Depth images on the CPU: a z-buffer that draws every instance once, into a window of its own, then composites.

Because an instance is alone in its window, its whole silhouette is counted on the way, the part that others hide and
the part beyond the frame included; that is what visibility needs, at no second rendering.

Pixels are sampled at their centres. Vertices are snapped to 1/4096 pixel and edges tested in integers with the top-left
rule, so that neighbouring triangles neither leave a gap nor share a pixel. Depth is that of the triangle's plane on
the pixel's ray: 1/z is affine in the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from evalkit.geometry.camera import Camera

BITS = 12
SUBPIXEL = 1 << BITS
GUARD = float(1 << 17)  # pixels; triangles are clipped there, so that snapped coordinates fit 32 bits, edges 64
WIDE = 16  # pixels; in triangles at least as wide, each row's ends are solved for instead of searched
BEYOND_FRAME = 1  # what is larger than the frame is counted this many frames beyond each border
NEAR_PER_EXTENT = 1e-3  # near plane, as a share of the mesh's extent
NOTHING = (np.zeros((0, 3)), np.zeros((0, 3), np.int32))  # a mesh without faces
_compiled = numba.njit(cache=True, nogil=True, error_model="numpy")


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
        background: vertices (B, 3) in metres, world frame, and faces (G, 3), drawn with id 0; nothing if left out.
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
        _draw_clipped(*self._background, cam_from_world, self._intrinsics, self._near, False, frame, nearness)
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
            return _draw_clipped(*mesh, self._near, self._cull, window, self._window)
        return _draw_tame(*mesh, self._cull, window, self._window)

    def _needs_clipping(self, cam_from_obj: NDArray[np.float64]) -> bool:
        """Whether the sphere around the mesh reaches behind the near plane or out of the guard band."""
        x, y, z = cam_from_obj[:3, :3] @ self._middle + cam_from_obj[:3, 3]
        nearest = z - self._radius
        if nearest < self._near:
            return True
        fx, fy, cx, cy = self._intrinsics
        aside = max(fx * (abs(x) + self._radius) / nearest + abs(cx), fy * (abs(y) + self._radius) / nearest + abs(cy))
        return bool(aside > GUARD)


def _as_mesh(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
    """Contiguous copies: one type each for the compiled code; unsigned, for numba checks signed indices' sign."""
    return np.array(vertices, np.float64, order="C"), np.array(faces, np.uint32, order="C")


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


@_compiled
def _draw_tame(vertices, faces, cam_from_obj, intrinsics, cull, window, out):  # type: ignore[no-untyped-def]
    """Draw 1/z of a mesh that needs no clipping into `out`; returns the box of pixels whose corner is `out[0, 0]`.

    It is drawn whole wherever it lies, unless it is larger than `window`: then only what is within it.
    """
    count = len(vertices)
    xs, ys, nearness = np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count)
    box = _project(vertices, cam_from_obj, intrinsics, xs, ys, nearness)
    if box[2] - box[0] > window[2] - window[0] or box[3] - box[1] > window[3] - window[1]:
        box = _intersection(box, window)
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        _fill(xs[a], ys[a], nearness[a], xs[b], ys[b], nearness[b], xs[c], ys[c], nearness[c], cull, box, out)
    return box


@_compiled
def _draw_clipped(vertices, faces, cam_from_mesh, intrinsics, near, cull, window, out):  # type: ignore[no-untyped-def]
    """Draw 1/z of the part of a mesh before the near plane and within the guard band; `out` covers all of `window`."""
    fx, fy, cx, cy = intrinsics
    polygon, cut = np.empty((8, 3)), np.empty((8, 3))
    xs, ys, nearness = np.empty(8, np.int32), np.empty(8, np.int32), np.empty(8)
    for face in range(len(faces)):
        for corner in range(3):
            x, y, z = vertices[faces[face, corner]]
            for k in range(3):
                polygon[corner, k] = _row(cam_from_mesh, k, x, y, z)
        size = _clip(polygon, cut, intrinsics, near)
        for i in range(size):
            nearness[i] = 1 / polygon[i, 2]
            xs[i] = _snap(fx * polygon[i, 0] * nearness[i] + cx)
            ys[i] = _snap(fy * polygon[i, 1] * nearness[i] + cy)
        for i in range(1, size - 1):
            _fill(
                xs[0], ys[0], nearness[0], xs[i], ys[i], nearness[i], xs[i + 1], ys[i + 1], nearness[i + 1],
                cull, window, out,
            )  # fmt: skip
    return window


@_compiled
def _project(vertices, cam_from_obj, intrinsics, xs, ys, nearness):  # type: ignore[no-untyped-def]
    """Fill in snapped image coordinates and 1/z; returns the box of pixels that they span."""
    fx, fy, cx, cy = intrinsics
    x0, y0, x1, y1 = np.int32(2**30), np.int32(2**30), np.int32(-(2**30)), np.int32(-(2**30))
    for i in range(len(vertices)):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        inverse = 1 / _row(cam_from_obj, 2, x, y, z)
        nearness[i] = inverse
        xs[i] = _snap(fx * _row(cam_from_obj, 0, x, y, z) * inverse + cx)
        ys[i] = _snap(fy * _row(cam_from_obj, 1, x, y, z) * inverse + cy)
        x0, y0, x1, y1 = min(x0, xs[i]), min(y0, ys[i]), max(x1, xs[i]), max(y1, ys[i])
    return _first_pixel(x0), _first_pixel(y0), _last_pixel(x1) + 1, _last_pixel(y1) + 1


@_compiled
def _row(transform, k, x, y, z):  # type: ignore[no-untyped-def]
    return transform[k, 0] * x + transform[k, 1] * y + transform[k, 2] * z + transform[k, 3]


@_compiled
def _snap(pixels):  # type: ignore[no-untyped-def]
    return np.int32(np.floor(pixels * SUBPIXEL + 0.5))


@_compiled
def _first_pixel(snapped):  # type: ignore[no-untyped-def]
    return np.int64((snapped + (SUBPIXEL - 1)) >> BITS)


@_compiled
def _last_pixel(snapped):  # type: ignore[no-untyped-def]
    return np.int64(snapped >> BITS)


@_compiled
def _intersection(box, window):  # type: ignore[no-untyped-def]
    return max(box[0], window[0]), max(box[1], window[1]), min(box[2], window[2]), min(box[3], window[3])


@_compiled
def _fill(ax, ay, aw, bx, by, bw, dx, dy, dw, cull, box, out):  # type: ignore[no-untyped-def]
    """Where `out` is smaller, put 1/z of the triangle whose corners are (x, y snapped, w = 1/z)."""
    area = np.int64(bx - ax) * np.int64(dy - ay) - np.int64(dx - ax) * np.int64(by - ay)
    if area == 0 or (cull and area > 0):  # rows go down, so outward faces turn the other way
        return
    u0, u1 = max(box[0], _first_pixel(min(ax, bx, dx))), min(box[2] - 1, _last_pixel(max(ax, bx, dx)))
    v0, v1 = max(box[1], _first_pixel(min(ay, by, dy))), min(box[3] - 1, _last_pixel(max(ay, by, dy)))
    if u0 > u1 or v0 > v1:
        return
    low, high = min(aw, bw, dw), max(aw, bw, dw)
    scale = np.float64(SUBPIXEL) / area
    per_u = ((bw - aw) * (dy - ay) - (dw - aw) * (by - ay)) * scale
    per_v = ((dw - aw) * (bx - ax) - (bw - aw) * (dx - ax)) * scale
    constant = aw - (per_u * ax + per_v * ay) / SUBPIXEL
    if area < 0:
        bx, by, dx, dy = dx, dy, bx, by
    e_ab, e_bd, e_da = _edge(ax, ay, bx, by, u0, v0), _edge(bx, by, dx, dy, u0, v0), _edge(dx, dy, ax, ay, u0, v0)
    ab_u, bd_u, da_u = np.int64(ay - by) << BITS, np.int64(by - dy) << BITS, np.int64(dy - ay) << BITS
    ab_v, bd_v, da_v = np.int64(bx - ax) << BITS, np.int64(dx - bx) << BITS, np.int64(ax - dx) << BITS
    wide = u1 - u0 >= WIDE
    for v in range(v0, v1 + 1):
        line, i = constant + per_v * v, np.uint64(v - box[1])
        if wide:
            first, last = _narrowed(u0, u1, u0, e_ab, ab_u)
            first, last = _narrowed(first, last, u0, e_bd, bd_u)
            first, last = _narrowed(first, last, u0, e_da, da_u)
            for u in range(first, last + 1):  # all are inside, so that the compiler does several at a time
                k = np.uint64(u - box[0])
                out[i, k] = max(out[i, k], np.float32(min(max(line + per_u * u, low), high)))
        else:
            in_ab, in_bd, in_da = e_ab, e_bd, e_da
            for u in range(u0, u1 + 1):
                value, k = np.float32(min(max(line + per_u * u, low), high)), np.uint64(u - box[0])
                before = out[i, k]  # no branches: which of the few pixels are inside nobody foretells
                out[i, k] = value if ((in_ab | in_bd | in_da) >= 0) & (value > before) else before
                in_ab, in_bd, in_da = in_ab + ab_u, in_bd + bd_u, in_da + da_u
        e_ab, e_bd, e_da = e_ab + ab_v, e_bd + bd_v, e_da + da_v


@_compiled
def _narrowed(first, last, start, value, step):  # type: ignore[no-untyped-def]
    """The pixels of first .. last where value + step * (u - start) is not negative."""
    if step > 0:
        return max(first, start - value // step), last
    if step < 0:
        return first, min(last, start + value // -step)
    return first, last if value >= 0 else first - 1


@_compiled
def _edge(ax, ay, bx, by, u, v):  # type: ignore[no-untyped-def]
    """Twice the area of a, b and the centre of pixel (u, v); a pixel on the edge belongs to top and left edges only."""
    value = np.int64(bx - ax) * ((v << BITS) - ay) - np.int64(by - ay) * ((u << BITS) - ax)
    return value if by < ay or (by == ay and bx > ax) else value - 1


@_compiled
def _clip(polygon, cut, intrinsics, near):  # type: ignore[no-untyped-def]
    """Cut the triangle in `polygon` at near plane and guard band (Sutherland and Hodgman 1974); its corners left."""
    fx, fy, cx, cy = intrinsics
    size = 3
    for a, b, c, d in (
        (0.0, 0.0, 1.0, -near),
        (fx, 0.0, cx + GUARD, 0.0), (-fx, 0.0, GUARD - cx, 0.0),
        (0.0, fy, cy + GUARD, 0.0), (0.0, -fy, GUARD - cy, 0.0),
    ):  # fmt: skip
        cut[:size] = polygon[:size]
        kept = 0
        for i in range(size):
            here, after = cut[i], cut[(i + 1) % size]
            inside = a * here[0] + b * here[1] + c * here[2] + d
            inside_after = a * after[0] + b * after[1] + c * after[2] + d
            if inside >= 0:
                polygon[kept] = here
                kept += 1
            if (inside >= 0) != (inside_after >= 0):
                polygon[kept] = here + (after - here) * (inside / (inside - inside_after))
                kept += 1
        size = kept
    return size


@_compiled
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


@_compiled
def _inverted(nearness):  # type: ignore[no-untyped-def]
    depth = np.zeros_like(nearness)
    for v in range(nearness.shape[0]):
        for u in range(nearness.shape[1]):
            if nearness[v, u] > 0:
                depth[v, u] = 1 / nearness[v, u]
    return depth
