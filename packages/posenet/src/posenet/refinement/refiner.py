"""Poses fitted to the depth image itself: many starts, ICP, evidence from the image, one pose a detection.

A network's rotation is often off by more than ICP can mend, most of all where little of an instance is seen. So the
hypotheses that the image speaks for most (:mod:`posenet.refinement.depth_evidence`), two of a detection, are also
started from turns of them to all sides; ICP is cheap. All poses of an image are fitted together. Of all fits of a
detection the best is kept, fitted once more from turns half as large, and then the set is verified, best first: a depth
pixel speaks for one pose only (after Aldoma et al. 2012, who do so for classical pipelines).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel, sample_surface_with_normals, surface_moments
from evalkit.scoring.distances import Sym
from posenet.network.depth_input import surface_normals
from posenet.refinement.depth_evidence import ALREADY_EXPLAINED, depth_evidence, explained_before
from posenet.refinement.icp import icp

Array = NDArray[np.float64]
POINTS = 500
TOLERANCE = 0.04  # diameters: depth agrees within this
ITERATIONS = 12
REACH = (0.12, 0.05)  # diameters: farthest point that ICP draws to, first and last iteration
SEARCHED = 2  # hypotheses of a detection that are turned: those that the image speaks for most after one fit
SEARCH = ((8, 25.0), (8, 12.0))  # rounds: turns to so many sides, by so many degrees; the second of one each
VIOLATION_WEIGHT = 0.5
PRIOR_WEIGHT = 0.3  # of a hypothesis's own score
PRIOR_REACH = 1.5  # of the object's threshold: how far from the hypothesis its score still speaks for a fit
HALF_SURE, STEEPNESS = 0.25, 16.0  # the evidence at which half the poses are right, and how fast that changes


@dataclass(frozen=True, eq=False)
class RefinedPoses:
    """m poses after refinement, best first, without those that others explain."""

    cam_from_obj: Array  # (m, 4, 4)
    hypothesis: NDArray[np.int64]  # (m,) which of those given each comes from
    score: Array  # (m,) in [0, 1]
    agreement: Array  # (m,) share of the camera-facing surface that the image shows where the pose has it
    violation: Array  # (m,) share that the camera looks through


class _Fits(NamedTuple):
    """n fitted poses on their way: which hypothesis each began as, and what the image says of it."""

    cam_from_obj: Array
    hypothesis: NDArray[np.int64]
    agreement: Array
    violation: Array
    evidence: Array

    def select(self, rows: NDArray[np.int64]) -> _Fits:
        return _Fits._make(part[rows] for part in self)

    def joined(self, other: _Fits) -> _Fits:
        return _Fits._make(np.concatenate(parts) for parts in zip(self, other, strict=True))


class Refiner:
    """Refines poses of one object.

    Raises:
        ValueError: the model has no mesh.
    """

    def __init__(self, model: ObjectModel) -> None:
        if model.vertices is None or model.faces is None:
            raise ValueError("refinement needs the object's mesh")
        self.model = model
        self.distance = Sym(model)
        self.points, self.normals = sample_surface_with_normals(model.vertices, model.faces, POINTS)
        self.spacing = float(np.sqrt(surface_moments(model.vertices, model.faces)[0] / POINTS))

    def refine(
        self,
        depth: NDArray[np.float32],
        camera: Camera,
        cam_from_obj: Array,
        score: Array,
        detection: NDArray[np.int64] | None = None,
    ) -> RefinedPoses:
        """Refine hypotheses (n, 4, 4) with scores (n,) in [0, 1] on a depth image (H, W) in meters.

        At most one pose is kept of all hypotheses with the same number in `detection` (n,); without it, of each.
        """
        if len(cam_from_obj) == 0:
            return RefinedPoses(np.zeros((0, 4, 4)), np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0))
        hypotheses = np.asarray(cam_from_obj, float)
        fitting = _Fitting(self, depth, camera, hypotheses, score)
        group = np.arange(len(score)) if detection is None else np.asarray(detection)
        fits = fitting.fitted(hypotheses, np.arange(len(score)))
        fits = fits.select(_best_of_each(fits.evidence, group[fits.hypothesis], SEARCHED))
        for sides, degrees in SEARCH:
            turned = turns(fits.cam_from_obj, self.model.centroid, sides, np.radians(degrees))
            fits = fits.joined(fitting.fitted(turned, np.repeat(fits.hypothesis, sides)))
            fits = fits.select(_best_of_each(fits.evidence, group[fits.hypothesis], 1))
        fits = fitting.verified(fits)
        return RefinedPoses(
            fits.cam_from_obj, fits.hypothesis, confidence(fits.evidence), fits.agreement, fits.violation
        )


class _Fitting:
    """One image, ready for poses to be fitted to it."""

    def __init__(
        self, refiner: Refiner, depth: NDArray[np.float32], camera: Camera, hypotheses: Array, score: Array
    ) -> None:
        self.refiner, self.depth = refiner, depth
        self.hypotheses, self.score = hypotheses, np.asarray(score, float)
        self.intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        self.normals = observed_normals(depth, self.intrinsics)

    def fitted(self, cam_from_obj: Array, hypothesis: NDArray[np.int64]) -> _Fits:
        """Poses (n, 4, 4) after ICP, and what the image says of them."""
        model, points, normals = self.refiner.model, self.refiner.points, self.refiner.normals
        moved, center, d = np.array(cam_from_obj), np.ascontiguousarray(model.centroid), model.diameter
        reach = np.linspace(*REACH, ITERATIONS) * d
        icp(moved, points - center, normals, center, self.depth, self.normals, self.intrinsics, reach, d)
        moved[:, :3, :3] = poses.nearest_rotation(moved[:, :3, :3])
        agreement, violation = depth_evidence(
            moved, points, normals, self.depth, self.normals, self.intrinsics, TOLERANCE * d
        )
        strayed = self.refiner.distance(moved, self.hypotheses[hypothesis]) / (PRIOR_REACH * model.threshold)
        prior = self.score[hypothesis] * np.exp(-0.5 * strayed**2)
        evidence = agreement - VIOLATION_WEIGHT * violation + PRIOR_WEIGHT * prior
        return _Fits(moved, hypothesis, agreement, violation, evidence)

    def verified(self, fits: _Fits) -> _Fits:
        """Best first, without duplicates; agreement with what better poses explain already speaks for none."""
        order = np.argsort(-fits.evidence, kind="stable")
        points, normals, tolerance = self.refiner.points, self.refiner.normals, TOLERANCE * self.refiner.model.diameter
        share = explained_before(
            fits.cam_from_obj, order, points, normals, self.depth, self.intrinsics, tolerance, self.refiner.spacing
        )
        fits = fits._replace(evidence=fits.evidence - share * fits.agreement)
        order = np.argsort(-fits.evidence, kind="stable")
        return fits.select(order[share[order] <= ALREADY_EXPLAINED])


def turns(cam_from_obj: Array, center: Array, sides: int, angle: float) -> Array:
    """Poses (n * sides, 4, 4): each of n turned about its `center` (3,) by `angle` radians, to evenly spread sides."""
    turn = poses.from_axis_angle(evenly_spread(sides), np.full(sides, angle))
    rotation = turn @ cam_from_obj[:, None, :3, :3]
    middle = poses.apply(cam_from_obj, center[None])
    return poses.from_rotation_translation(rotation, middle - rotation @ center).reshape(-1, 4, 4)


def evenly_spread(count: int) -> Array:
    """Directions (count, 3) along a Fibonacci spiral over the sphere."""
    number = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * number / count, np.pi * (1.0 + 5.0**0.5) * number
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1)


def confidence(evidence: Array) -> Array:
    """Evidence (n,) as a score (n,) in [0, 1]: about the share of such poses that are right."""
    return np.asarray(1.0 / (1.0 + np.exp(-STEEPNESS * (evidence - HALF_SURE))))


def observed_normals(depth: NDArray[np.float32], intrinsics: Array) -> NDArray[np.float32]:
    """Normals (H, W, 3) toward the camera of a depth image (H, W)."""
    found = surface_normals(torch.from_numpy(depth)[None], torch.from_numpy(intrinsics).float()[None])
    return np.ascontiguousarray(found[0].permute(1, 2, 0).numpy())


def _best_of_each(evidence: Array, group: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """The `count` rows with the most evidence (n,) of each group (n,)."""
    order = np.lexsort((-evidence, group))
    begin = np.searchsorted(group[order], group[order])
    return np.asarray(order[np.arange(len(order)) - begin < count])
