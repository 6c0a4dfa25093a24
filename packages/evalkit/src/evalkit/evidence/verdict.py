"""Whether a depth image verifies a pose, contradicts it, or cannot tell.

The object is ray traced at the pose, fitted to the image first (:mod:`evalkit.evidence.pose_fit`). At each pixel of its
silhouette the measured depth

* is the surface's own: it *agrees*;
* lies behind: the camera *looks through* where the surface should be, which no occlusion explains;
* lies in front: something may hide the surface, which says nothing;
* is missing, which says nothing either.

Where it all agrees but goes on beyond the silhouette, without an edge, the pose is undecided: a plate's face agrees
with any floor, wherever it is put.

Surface that the camera sees at a grazing angle is left out: there a pixel's width changes depth by more than the
tolerance, and stereo cameras smear edges.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evalkit.depth.noise import depth_noise
from evalkit.evidence.contour import share_going_on
from evalkit.evidence.pose_fit import fitted
from evalkit.evidence.ray_tracer import RayTracer, Traced
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from evalkit.scoring.distances import Sym

Array = NDArray[np.float64]
TOLERANCE = 0.035  # diameters: depth agrees within this …
LEAST_TOLERANCE = 1e-3  # … or within this many meters, which no common depth camera keeps to
LARGEST_TOLERANCE = 0.08  # diameters, however noisy the image is
NOISE = 4.0  # standard deviations of the image's noise that agree
GRAZING = 0.25  # cosine between surface normal and ray, below which a pixel is left out
WELL = 0.5  # of the tolerance: what agrees so well is all but certain
LEAST_WELL = 0.7  # of the agreeing pixels do, where a surface is the object's own
LEAST_AGREEMENT = 0.7  # of the pixels that agree or are looked through
MOST_THROUGH = 0.2  # of the silhouette
LEAST_SEEN = 0.2  # of the silhouette that agrees, less THROUGH_WEIGHT of what is looked through; below, who can tell
THROUGH_WEIGHT = 0.3
MOST_GOING_ON = 0.5  # of the contour; a face in the plane of a floor could as well be a step farther
FEWEST = 40  # pixels that agree; fewer verify nothing


class Verdict(str, Enum):
    """What an image says of a pose."""

    VERIFIED = "verified"
    CONTRADICTED = "contradicted"
    UNDECIDED = "undecided"


@dataclass(frozen=True, eq=False)
class PoseEvidence:
    """What an image says of a pose; shares are those of its silhouette that does not graze."""

    verdict: Verdict
    reason: str
    agreeing: float
    through: float
    hidden: float  # something lies in front
    missing: float  # no return, or beyond the image
    moved: float  # meters (root mean square over the surface) between the pose and the one fitted to the image
    cam_from_obj: Array  # (4, 4) the fitted pose
    pixels: NDArray[np.int64]  # flat indices of those that agree …
    stride: int  # … of every so many rows and columns


class Verifier:
    """Holds poses of one object against depth images.

    Args:
        tolerance: meters within which depth agrees; None takes 3.5 % of the diameter, more in noisy images.

    Raises:
        InputError: the model has no mesh, or embreex is not installed.
    """

    def __init__(self, model: ObjectModel, tolerance: float | None = None) -> None:
        self.model, self.tolerance = model, tolerance
        self._tracer, self._distance = RayTracer(model), Sym(model)

    def examine(self, depth: NDArray[np.float32], camera: Camera, cam_from_obj: Array) -> list[PoseEvidence]:
        """Evidence for each of n poses (n, 4, 4) on a depth image (height, width) in meters, 0 = no return."""
        tolerance = self.tolerance or self.tolerance_in(depth)
        return [self._examine(depth, camera, pose, tolerance) for pose in np.asarray(cam_from_obj, float)]

    def tolerance_in(self, depth: NDArray[np.float32]) -> float:
        """Meters within which depth agrees in an image of its noise."""
        diameter = self.model.diameter
        wanted = max(TOLERANCE * diameter, LEAST_TOLERANCE, NOISE * depth_noise(depth))
        return float(min(wanted, max(LARGEST_TOLERANCE * diameter, LEAST_TOLERANCE)))

    def _examine(self, depth: NDArray[np.float32], camera: Camera, given: Array, tolerance: float) -> PoseEvidence:
        model = self.model
        pose = fitted(given, self._tracer, depth, camera, model.centroid, model.diameter)
        moved = float(self._distance(given[None], pose[None])[0])
        traced = self._tracer.trace(pose, camera)
        return _judged(traced, depth, camera, tolerance, moved, model.threshold, pose)


class _Counts(NamedTuple):
    """Pixels of a silhouette of which the depth image says something."""

    agreeing: int
    well: int  # of them, within half the tolerance
    through: int
    hidden: int
    silhouette: float  # of all, those beyond the image included


def _judged(
    traced: Traced,
    depth: NDArray[np.float32],
    camera: Camera,
    tolerance: float,
    moved: float,
    threshold: float,
    pose: Array,
) -> PoseEvidence:
    ray = np.stack([(traced.u - camera.cx) / camera.fx, (traced.v - camera.cy) / camera.fy, np.ones(len(traced))], -1)
    cosine = -np.einsum("nk,nk->n", traced.normal, ray) / np.linalg.norm(ray, axis=-1)
    plain = cosine >= GRAZING
    u, v = traced.u[plain], traced.v[plain]
    gap, known = depth[v, u] - traced.depth[plain], depth[v, u] > 0
    agrees = known & (np.abs(gap) <= tolerance)
    counts = _Counts(
        int(agrees.sum()),
        int((known & (np.abs(gap) <= WELL * tolerance)).sum()),
        int((known & (gap > tolerance)).sum()),
        int((known & (gap < -tolerance)).sum()),
        len(u) * (1.0 + traced.outside / max(len(traced), 1)),
    )
    verdict, reason = _rule(counts, traced.stride, moved / threshold)
    if verdict is Verdict.VERIFIED:
        asked = np.zeros(len(traced), bool)
        asked[np.flatnonzero(plain)[agrees]] = True
        share = share_going_on(traced, depth, camera, asked, WELL * tolerance)
        if share > MOST_GOING_ON:
            verdict, reason = Verdict.UNDECIDED, f"its surface goes on beyond {share:.0%} of its contour, as a floor's"
    agreeing, through, hidden = (
        part / max(counts.silhouette, 1.0) for part in (counts.agreeing, counts.through, counts.hidden)
    )
    return PoseEvidence(
        verdict=verdict,
        reason=reason,
        agreeing=agreeing,
        through=through,
        hidden=hidden,
        missing=max(0.0, 1.0 - agreeing - through - hidden),
        moved=moved,
        cam_from_obj=pose,
        pixels=v[agrees] * camera.width + u[agrees],
        stride=traced.stride,
    )


def _rule(counts: _Counts, stride: int, moved: float) -> tuple[Verdict, str]:
    """The verdict, from how far the fit `moved`, in thresholds, too; and why."""
    agreeing, well, through, hidden, silhouette = counts
    if silhouette < 1:
        return Verdict.CONTRADICTED, "it lies outside the image"
    if through > MOST_THROUGH * silhouette or agreeing < LEAST_AGREEMENT * (agreeing + through):
        return Verdict.CONTRADICTED, f"the camera looks through {through / silhouette:.0%} of it"
    if agreeing - THROUGH_WEIGHT * through < LEAST_SEEN * silhouette or agreeing * stride**2 < FEWEST:
        return Verdict.UNDECIDED, f"only {agreeing / silhouette:.0%} of it is seen, {hidden / silhouette:.0%} is hidden"
    if moved > 1.0:
        return Verdict.CONTRADICTED, "the image shows the object elsewhere"
    if well < LEAST_WELL * agreeing:
        return Verdict.UNDECIDED, "what is seen there fits it loosely"
    return Verdict.VERIFIED, f"{agreeing / silhouette:.0%} of it is seen where it should be"
