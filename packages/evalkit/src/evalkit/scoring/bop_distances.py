"""MSSD and MSPD: the largest displacement of any model point, in space and in the image, modulo symmetry.

Hodaň et al. 2020, "BOP Challenge 2020 on 6D object localization", section 2.2. Continuous symmetries are sampled as
there: the point farthest from the axis travels at most a hundredth of the diameter between samples. A sphere's are
taken exactly.

For each pair, a few far-apart points bound every symmetric candidate from below; only candidates whose bound is below
the best one's true value are computed in full, so the minimum is exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from evalkit.scoring.model_points import model_points

Array = NDArray[np.float64]
SYMMETRY_STEPS = 315  # ceil(pi / 0.01), BOP's max_sym_disc_step
BOUND_POINTS = 16
REFERENCE_WIDTH = 640  # pixels; MSPD is that of an image so wide
BLOCK_NUMBERS = 4_000_000  # float64 numbers held at once: 32 MB


class Mssd:
    """MSSD in meters: max over points of ``|estimate x - truth g x|``, min over symmetries g."""

    def __init__(self, model: ObjectModel, limit: float = np.inf) -> None:
        """Distances above `limit` may come out as any value between `limit` and the true one."""
        self.limit = limit
        self.model_points = _convex_hull(model_points(model, "mssd"))  # a convex function is largest there
        self.mean = self.model_points.mean(0)
        self.bound_points = spread_points(self.model_points, BOUND_POINTS)
        self.model = model
        turns = model.symmetry.elements(SYMMETRY_STEPS) if model.symmetry.kind != "sphere" else np.eye(3)[None]
        self.symmetries = poses.from_rotation_translation(turns, model.centroid - turns @ model.centroid)
        # Some point moves as far as their mean, which a symmetry turns about the centroid.
        self.slack = 2.0 * float(np.linalg.norm(self.mean - model.centroid))

    def points(self, cam_from_obj: Array) -> Array:
        return poses.apply(cam_from_obj, self.mean[None])[:, 0]

    def __call__(self, estimate: Array, truth: Array, intrinsics: Array | None = None) -> Array:
        if self.model.symmetry.kind == "sphere":
            truth = self._turned_like(truth, estimate)
        intrinsics = np.zeros((len(estimate), 5)) if intrinsics is None else intrinsics
        rows = max(1, BLOCK_NUMBERS // (3 * len(self.bound_points) * len(self.symmetries)))
        starts = range(0, len(estimate), rows)
        parts = [self._block(*(a[i : i + rows] for a in (estimate, truth, intrinsics))) for i in starts]
        return np.concatenate(parts) if parts else np.zeros(0)

    def displacement(self, estimate: Array, truth: Array, points: Array, intrinsics: Array) -> Array:
        """Of points (k, 3) under poses (..., 4, 4): (..., k); `intrinsics` (..., 5) broadcast alike."""
        return np.asarray(np.linalg.norm(poses.apply(estimate - truth, points), axis=-1))

    def _block(self, estimate: Array, truth: Array, intrinsics: Array) -> Array:
        candidates = truth[:, None] @ self.symmetries
        bound = self.displacement(estimate[:, None], candidates, self.bound_points, intrinsics[:, None]).max(-1)
        result = bound.min(-1)
        near = np.flatnonzero(result <= self.limit)
        first = candidates[near, bound[near].argmin(-1)]
        result[near] = self._largest(estimate[near], first, intrinsics[near])
        row, candidate = np.nonzero(bound[near] < result[near, None])
        row = near[row]
        exact = self._largest(estimate[row], candidates[row, candidate], intrinsics[row])
        np.minimum.at(result, row, exact)
        return np.asarray(result)

    def _largest(self, estimate: Array, truth: Array, intrinsics: Array) -> Array:
        rows = max(1, BLOCK_NUMBERS // (3 * len(self.model_points)))
        result = np.zeros(len(estimate))
        for i in range(0, len(estimate), rows):
            block = slice(i, i + rows)
            moved = self.displacement(estimate[block], truth[block], self.model_points, intrinsics[block])
            result[block] = moved.max(-1)
        return result

    def _turned_like(self, truth: Array, estimate: Array) -> Array:
        """The pose equivalent to `truth` with the rotation of `estimate`: what a sphere's symmetry allows."""
        rotation = estimate[:, :3, :3]
        shift = self.model.centers(truth) - (rotation @ self.model.centroid[:, None])[..., 0]
        return poses.from_rotation_translation(rotation, shift)


class Mspd(Mssd):
    """MSPD in pixels of an image 640 wide: as MSSD, of the points' projections; `intrinsics` are needed."""

    def __init__(self, model: ObjectModel, limit: float = np.inf) -> None:
        super().__init__(model, limit)
        self.model_points = model_points(model, "mspd")  # the projection's displacement is not convex
        self.bound_points = spread_points(self.model_points, BOUND_POINTS)
        self.slack = np.inf  # no point in space bounds a distance in the image

    def __call__(self, estimate: Array, truth: Array, intrinsics: Array | None = None) -> Array:
        if intrinsics is None:
            raise ValueError("MSPD needs the cameras' intrinsics (n, 5): fx, fy, cx, cy, width")
        return super().__call__(estimate, truth, intrinsics)

    def displacement(self, estimate: Array, truth: Array, points: Array, intrinsics: Array) -> Array:
        gap = _project(estimate, points, intrinsics) - _project(truth, points, intrinsics)
        pixels = np.linalg.norm(gap, axis=-1) * (REFERENCE_WIDTH / intrinsics[..., None, 4])
        return np.nan_to_num(pixels, nan=np.inf)


def spread_points(points: Array, count: int) -> Array:
    """At most `count` of points (n, 3), each the farthest from those before: (m, 3)."""
    gap = np.linalg.norm(points - points.mean(0), axis=1)
    chosen: list[int] = []
    for _ in range(min(count, len(points))):
        chosen.append(int(gap.argmax()))
        to_last = np.linalg.norm(points - points[chosen[-1]], axis=1)
        gap = to_last if len(chosen) == 1 else np.minimum(gap, to_last)
    return points[chosen]


def _project(pose: Array, points: Array, intrinsics: Array) -> Array:
    """Pixels (..., k, 2); what lies behind the camera is projected to infinity."""
    x, y, z = np.moveaxis(poses.apply(pose, points), -1, 0)
    fx, fy, cx, cy, _ = np.moveaxis(intrinsics, -1, 0)[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(z > 0, z, np.nan)
        return np.stack([fx * x / depth + cx, fy * y / depth + cy], -1)


def _convex_hull(points: Array) -> Array:
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:  # flat, or too few: all of them are extreme enough
        return points
