"""Poses against the depth image itself: ICP, a score from what the image shows, and one pose an instance.

All hypotheses of an image are refined together. A model is a set of surface points with normals; whether the image
agrees with a pose is asked at the pixels that its camera-facing points project to:

* the depth there is the point's own: *support*;
* it lies in front: another object may hide the point, which says nothing;
* it lies behind: the camera looks through where the surface should be: *violation*.

Verification then goes through the poses, best first, and lets each depth pixel be explained once (after Aldoma et al.
2012, who do so for classical pipelines).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import torch
from numpy.typing import NDArray

from evalkit import poses
from evalkit.camera import Camera
from evalkit.objects import ObjectModel, sample_surface_with_normals
from posenet.depth_input import surface_normals

Array = NDArray[np.float64]
POINTS = 500
ITERATIONS = 12
TOLERANCE = 0.04  # diameters: depth agrees within this
REACH = (0.12, 0.05)  # diameters: farthest point that ICP draws to, first and last iteration
LEAST_NORMAL_COSINE = 0.4
DAMPING = 1e-3
ALREADY_EXPLAINED = 0.5  # a pose with more of its support explained by better poses is a duplicate


@dataclass(frozen=True, eq=False)
class RefinedPoses:
    """n poses after refinement, in the order given."""

    cam_from_obj: Array  # (n, 4, 4)
    support: Array  # (n,) share of the camera-facing surface that the image shows where the pose has it
    violation: Array  # (n,) share that the camera looks through
    duplicate: NDArray[np.bool_]  # (n,) explained by better poses

    @property
    def evidence(self) -> Array:
        """(n,) in [0, 1]: support over support and violation, weighed down where little is seen at all."""
        seen = self.support + self.violation
        return self.support / np.maximum(seen, 1e-9) * np.minimum(1.0, seen / 0.5) ** 0.5


class Refiner:
    """Refines poses of one object.

    Raises:
        ValueError: the model has no mesh.
    """

    def __init__(self, model: ObjectModel) -> None:
        if model.vertices is None or model.faces is None:
            raise ValueError("refinement needs the object's mesh")
        self.model = model
        self.points, self.normals = sample_surface_with_normals(model.vertices, model.faces, POINTS)

    def refine(self, depth: NDArray[np.float32], camera: Camera, cam_from_obj: Array, score: Array) -> RefinedPoses:
        """Refine poses (n, 4, 4) with scores (n,), higher first served, on a depth image (H, W) in metres."""
        intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        normals = observed_normals(depth, intrinsics)
        refined = np.ascontiguousarray(cam_from_obj, dtype=np.float64).copy()
        d = self.model.diameter
        reach = np.linspace(REACH[0], REACH[1], ITERATIONS) * d
        center = np.ascontiguousarray(self.model.centroid)
        _icp(refined, self.points - center, self.normals, center, depth, normals, intrinsics, reach, d)
        refined[:, :3, :3] = poses.nearest_rotation(refined[:, :3, :3]) if len(refined) else refined[:, :3, :3]
        support, violation = _depth_evidence(refined, self.points, self.normals, depth, intrinsics, TOLERANCE * d)
        found = RefinedPoses(refined, support, violation, np.zeros(len(refined), bool))
        order = np.argsort(-found.evidence * (0.5 + 0.5 * score), kind="stable")
        duplicate = _verify(refined, order, self.points, self.normals, depth, intrinsics, TOLERANCE * d)
        return RefinedPoses(refined, support, violation, duplicate)


def observed_normals(depth: NDArray[np.float32], intrinsics: Array) -> NDArray[np.float32]:
    """Normals (H, W, 3) towards the camera of a depth image (H, W)."""
    found = surface_normals(torch.from_numpy(depth)[None], torch.from_numpy(intrinsics).float()[None])
    return np.ascontiguousarray(found[0].permute(1, 2, 0).numpy())


@numba.njit(cache=True, parallel=True, fastmath=True)
def _icp(
    pose: Any,
    points: Any,
    normals: Any,
    center: Any,
    depth: Any,
    observed: Any,
    intrinsics: Any,
    reach: Any,
    size: float,
) -> None:
    """Projective point-to-plane ICP (Chen & Medioni 1991; Blais & Levine 1995), in place, on poses (n, 4, 4).

    `points` (P, 3) are relative to `center`, about which each step turns; lengths are scaled by `size` so that one
    damping serves turns and shifts alike, and keeps still what the depth does not determine.
    """
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    for i in numba.prange(len(pose)):
        rotation = pose[i, :3, :3].copy()
        origin = rotation @ center + pose[i, :3, 3]
        for step in range(len(reach)):
            a = np.zeros((6, 6))
            b = np.zeros(6)
            limit = reach[step]
            row = np.empty(6)
            for k in range(len(points)):
                q = rotation @ points[k]
                n = rotation @ normals[k]
                x, y, z = q[0] + origin[0], q[1] + origin[1], q[2] + origin[2]
                if z <= 1e-6 or n[0] * x + n[1] * y + n[2] * z >= 0.0:
                    continue
                u, v = int(np.floor(fx * x / z + cx + 0.5)), int(np.floor(fy * y / z + cy + 0.5))
                if u < 0 or v < 0 or u >= width or v >= height:
                    continue
                seen = depth[v, u]
                if seen <= 0.0 or abs(seen - z) > limit:
                    continue
                m = observed[v, u]
                if m[0] * n[0] + m[1] * n[1] + m[2] * n[2] < LEAST_NORMAL_COSINE:
                    continue
                px, py = (u - cx) / fx * seen, (v - cy) / fy * seen
                residual = ((px - x) * m[0] + (py - y) * m[1] + (seen - z) * m[2]) / size
                weight = 1.0 / (1.0 + (residual * size / (0.3 * limit)) ** 2)
                row[0] = (q[1] * m[2] - q[2] * m[1]) / size
                row[1] = (q[2] * m[0] - q[0] * m[2]) / size
                row[2] = (q[0] * m[1] - q[1] * m[0]) / size
                row[3], row[4], row[5] = m[0], m[1], m[2]
                for r in range(6):
                    b[r] += weight * row[r] * residual
                    for c in range(6):
                        a[r, c] += weight * row[r] * row[c]
            trace = a[0, 0] + a[1, 1] + a[2, 2] + a[3, 3] + a[4, 4] + a[5, 5]
            if trace < 1e-9:
                break
            for r in range(6):
                a[r, r] += DAMPING * trace
            delta = np.linalg.solve(a, b)
            angle = np.sqrt(delta[0] ** 2 + delta[1] ** 2 + delta[2] ** 2)
            if angle > 1e-12:
                rotation = _turn(delta[:3] / angle, min(angle, 0.3)) @ rotation
            origin = origin + delta[3:] * size
        pose[i, :3, :3] = rotation
        pose[i, :3, 3] = origin - rotation @ center


@numba.njit(cache=True, fastmath=True)
def _turn(axis: Any, angle: float) -> Any:
    """Rodrigues' formula."""
    s, c = np.sin(angle), np.cos(angle)
    x, y, z = axis
    k = 1.0 - c
    return np.array(
        [
            [c + x * x * k, x * y * k - z * s, x * z * k + y * s],
            [y * x * k + z * s, c + y * y * k, y * z * k - x * s],
            [z * x * k - y * s, z * y * k + x * s, c + z * z * k],
        ]
    )


@numba.njit(cache=True, parallel=True, fastmath=True)
def _depth_evidence(pose: Any, points: Any, normals: Any, depth: Any, intrinsics: Any, tolerance: float) -> Any:
    """Support and violation (n,) of poses (n, 4, 4); points weigh as much as the image sees of their surface."""
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    support, violation = np.zeros(len(pose)), np.zeros(len(pose))
    for i in numba.prange(len(pose)):
        rotation, origin = pose[i, :3, :3].copy(), pose[i, :3, 3].copy()
        facing = agreeing = through = 0.0
        for k in range(len(points)):
            p = rotation @ points[k] + origin
            n = rotation @ normals[k]
            slant = -(n[0] * p[0] + n[1] * p[1] + n[2] * p[2])
            if p[2] <= 1e-6 or slant <= 0.0:
                continue
            weight = slant / np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
            facing += weight
            u, v = int(np.floor(fx * p[0] / p[2] + cx + 0.5)), int(np.floor(fy * p[1] / p[2] + cy + 0.5))
            if u < 0 or v < 0 or u >= width or v >= height or depth[v, u] <= 0.0:
                continue
            gap = depth[v, u] - p[2]
            if gap > tolerance:
                through += weight
            elif gap > -tolerance:
                agreeing += weight
        if facing > 0.0:
            support[i], violation[i] = agreeing / facing, through / facing
    return support, violation


@numba.njit(cache=True, fastmath=True)
def _verify(pose: Any, order: Any, points: Any, normals: Any, depth: Any, intrinsics: Any, tolerance: float) -> Any:
    """Which poses (n,) have most of their support explained by poses that come earlier in `order`."""
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    explained = np.zeros((height, width), np.bool_)
    duplicate = np.zeros(len(pose), np.bool_)
    pixel = np.empty((len(points), 2), np.int64)
    for i in order:
        rotation, origin = pose[i, :3, :3].copy(), pose[i, :3, 3].copy()
        count = taken = 0
        for k in range(len(points)):
            p = rotation @ points[k] + origin
            n = rotation @ normals[k]
            if p[2] <= 1e-6 or n[0] * p[0] + n[1] * p[1] + n[2] * p[2] >= 0.0:
                continue
            u, v = int(np.floor(fx * p[0] / p[2] + cx + 0.5)), int(np.floor(fy * p[1] / p[2] + cy + 0.5))
            if u < 0 or v < 0 or u >= width or v >= height or abs(depth[v, u] - p[2]) > tolerance:
                continue
            pixel[count, 0], pixel[count, 1] = u, v
            count += 1
            taken += explained[v, u]
        if taken > ALREADY_EXPLAINED * count or count == 0:
            duplicate[i] = True
            continue
        for k in range(count):
            u, v = pixel[k]
            explained[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2] = True
    return duplicate
