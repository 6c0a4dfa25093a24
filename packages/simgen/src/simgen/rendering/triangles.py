"""Triangles into a z-buffer of 1/z, compiled: projected, clipped where they must be, filled.

Vertices are snapped to 1/4096 pixel and edges tested in integers with the top-left rule, so that neighboring triangles
neither leave a gap nor share a pixel. Pixels are sampled at their centers; 1/z is affine in the image.
"""

from __future__ import annotations

import numpy as np

from simgen.compiled import compiled

BITS = 12
SUBPIXEL = 1 << BITS
GUARD = float(1 << 17)  # pixels; triangles are clipped there, so that snapped coordinates fit 32 bits, edges 64
WIDE = 16  # pixels; in triangles at least as wide, each row's ends are solved for instead of searched


@compiled
def draw_tame(vertices, faces, cam_from_obj, intrinsics, cull, window, out):  # type: ignore[no-untyped-def]
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


@compiled
def draw_clipped(vertices, faces, cam_from_mesh, intrinsics, near, cull, window, out):  # type: ignore[no-untyped-def]
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


@compiled
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


@compiled
def _row(transform, k, x, y, z):  # type: ignore[no-untyped-def]
    return transform[k, 0] * x + transform[k, 1] * y + transform[k, 2] * z + transform[k, 3]


@compiled
def _snap(pixels):  # type: ignore[no-untyped-def]
    return np.int32(np.floor(pixels * SUBPIXEL + 0.5))


@compiled
def _first_pixel(snapped):  # type: ignore[no-untyped-def]
    return np.int64((snapped + (SUBPIXEL - 1)) >> BITS)


@compiled
def _last_pixel(snapped):  # type: ignore[no-untyped-def]
    return np.int64(snapped >> BITS)


@compiled
def _intersection(box, window):  # type: ignore[no-untyped-def]
    return max(box[0], window[0]), max(box[1], window[1]), min(box[2], window[2]), min(box[3], window[3])


@compiled
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


@compiled
def _narrowed(first, last, start, value, step):  # type: ignore[no-untyped-def]
    """The pixels of first .. last where value + step * (u - start) is not negative."""
    if step > 0:
        return max(first, start - value // step), last
    if step < 0:
        return first, min(last, start + value // -step)
    return first, last if value >= 0 else first - 1


@compiled
def _edge(ax, ay, bx, by, u, v):  # type: ignore[no-untyped-def]
    """Twice the area of a, b and the center of pixel (u, v); a pixel on the edge belongs to top and left edges only."""
    value = np.int64(bx - ax) * ((v << BITS) - ay) - np.int64(by - ay) * ((u << BITS) - ax)
    return value if by < ay or (by == ay and bx > ax) else value - 1


@compiled
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
