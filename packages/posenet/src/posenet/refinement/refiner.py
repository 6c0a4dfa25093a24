"""Poses fitted to the depth image itself: many starts, ICP, evidence from the image, one pose a detection.

A network's rotation is often off by more than ICP can mend, most of all where little of an instance is seen. So the
hypotheses that the image speaks for most (:mod:`posenet.refinement.depth_evidence`), two of a detection, are also
started from turns of them to all sides; ICP is cheap. All poses of an image are fitted together. Of all fits of a
detection the best is kept and fitted once more from turns half as large. A judge that learned from simulated piles
says how likely each is right (:mod:`posenet.refinement.judge`), and the set is verified
(:mod:`posenet.refinement.competition`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.depth_views import sphere_directions
from evalkit.objects.model import ObjectModel, sample_surface_with_normals, surface_moments
from evalkit.scoring.distances import Sym
from posenet.refinement.appearance import appearance
from posenet.refinement.competition import explained, settled
from posenet.refinement.depth_evidence import depth_evidence
from posenet.refinement.fits import Finalists, Fits, RefinedPoses
from posenet.refinement.icp import icp
from posenet.refinement.judge import Judge, shipped_judge
from posenet.refinement.observed import observed
from posenet.refinement.pose_evidence import FARTHEST, as_columns, company, search_columns
from posenet.refinement.solid import Solid, close_pairs, interpenetration

Array = NDArray[np.float64]
NOTHING = RefinedPoses(np.zeros((0, 4, 4)), np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0))
POINTS = 500
TOLERANCE = 0.04  # diameters: depth agrees within this
ITERATIONS = 12
REACH = (0.12, 0.05)  # diameters: farthest point that ICP draws to, first and last iteration
SEARCHED = 2  # hypotheses of a detection that are turned: those that the image speaks for most after one fit
SEARCH = ((8, 25.0), (8, 12.0))  # rounds: turns to so many sides, by so many degrees; the second of one each
# While searching, agreement counts 1:
VIOLATION_WEIGHT = 0.5
PRIOR_WEIGHT = 0.3  # of a hypothesis's own score
PRIOR_REACH = 1.5  # of the object's threshold: how far from the hypothesis its score still speaks for a fit
JUDGED_POINTS = 1500  # of the surface, when fits are judged; more than searching can afford


class Refiner:
    """Refines poses of one object, and has them judged: by the judge that comes along, unless another is given.

    Raises:
        ValueError: the model has no mesh.
    """

    def __init__(self, model: ObjectModel, judge: Judge | None = None) -> None:
        if model.vertices is None or model.faces is None:
            raise ValueError("refinement needs the object's mesh")
        self.model, self.judge = model, judge or shipped_judge()
        self.distance, self.solid = Sym(model), Solid(model)
        self.points, self.normals = sample_surface_with_normals(model.vertices, model.faces, POINTS)
        self.judged = sample_surface_with_normals(model.vertices, model.faces, JUDGED_POINTS)
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
        group = np.arange(len(score)) if detection is None else np.asarray(detection)
        return refine_together([Fitting(self, depth, camera, np.asarray(cam_from_obj, float), score, group)])[0]


def refine_together(fittings: Sequence[Fitting]) -> list[RefinedPoses]:
    """The refined poses of each of several parts in one image, which compete for what it shows."""
    found = [NOTHING] * len(fittings)
    rows = [row for row, fitting in enumerate(fittings) if len(fitting.score)]
    some = [fittings[row] for row in rows]
    if some:
        refined = settled(some, [fitting.judged(*fitting.search()) for fitting in some])
        for row, those in zip(rows, refined, strict=True):
            found[row] = those
    return found


class Fitting:
    """One image, ready for poses to be fitted to it."""

    def __init__(
        self,
        refiner: Refiner,
        depth: NDArray[np.float32],
        camera: Camera,
        hypotheses: Array,
        score: Array,
        group: NDArray[np.int64],
    ) -> None:
        self.refiner = refiner
        self.hypotheses, self.score, self.group = hypotheses, np.asarray(score, float), group
        self.intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        self.observed = observed(depth, self.intrinsics)
        self.depth, self.normals = self.observed[..., 0], self.observed[..., 1:]
        self.tolerance = TOLERANCE * refiner.model.diameter

    def search(self) -> tuple[Fits, Fits]:
        """The best fit of each detection, and all that were tried."""
        fits = tried = self.fitted(self.hypotheses, np.arange(len(self.hypotheses)))
        fits = fits.select(_best_of_each(fits.evidence, self.group[fits.hypothesis], SEARCHED))
        for sides, degrees in SEARCH:
            turned = turns(fits.cam_from_obj, self.refiner.model.centroid, sides, np.radians(degrees))
            more = self.fitted(turned, np.repeat(fits.hypothesis, sides))
            fits, tried = fits.joined(more), tried.joined(more)
            fits = fits.select(_best_of_each(fits.evidence, self.group[fits.hypothesis], 1))
        return fits, tried

    def fitted(self, cam_from_obj: Array, hypothesis: NDArray[np.int64]) -> Fits:
        """Poses (n, 4, 4) after ICP, and what the image says of them."""
        model, points, normals = self.refiner.model, self.refiner.points, self.refiner.normals
        moved, center, d = np.array(cam_from_obj), np.ascontiguousarray(model.centroid), model.diameter
        reach = np.linspace(*REACH, ITERATIONS) * d
        icp(moved, points - center, normals, center, self.observed, self.intrinsics, reach, d)
        moved[:, :3, :3] = poses.nearest_rotation(moved[:, :3, :3])
        agreement, violation = depth_evidence(
            moved, points, normals, self.depth, self.normals, self.intrinsics, self.tolerance
        )
        strayed = self.refiner.distance(moved, self.hypotheses[hypothesis]) / (PRIOR_REACH * model.threshold)
        prior = self.score[hypothesis] * np.exp(-0.5 * strayed**2)
        evidence = agreement - VIOLATION_WEIGHT * violation + PRIOR_WEIGHT * prior
        return Fits(moved, hypothesis, agreement, violation, evidence)

    def judged(self, fits: Fits, tried: Fits) -> Finalists:
        """What there is to say of the best fits, in view of all that were tried."""
        refiner, model = self.refiner, self.refiner.model
        shown = appearance(
            fits.cam_from_obj, *refiner.judged, np.ascontiguousarray(model.centroid), model.diameter,
            self.depth, self.normals, self.intrinsics, self.tolerance,
        )  # fmt: skip
        detection, of = np.unique(self.group[fits.hypothesis], return_inverse=True)
        row = np.argsort(of)[np.searchsorted(detection, self.group[tried.hypothesis])]
        pairs = close_pairs(model.centers(fits.cam_from_obj), model.diameter)
        apart = self._apart(fits.cam_from_obj[pairs[:, 0]], fits.cam_from_obj[pairs[:, 1]])
        strayed = self._apart(fits.cam_from_obj, self.hypotheses[fits.hypothesis])
        alone = {
            **as_columns(shown),
            **search_columns(fits.cam_from_obj, fits.evidence, tried.cam_from_obj, tried.evidence, row, self._apart),
            "prior": self.score[fits.hypothesis],
            "strayed": np.minimum(strayed, FARTHEST),
            "company": company(len(fits.evidence), pairs, apart),
            "evidence": fits.evidence,
        }
        one = np.zeros(len(fits.evidence), np.int64)
        deep = interpenetration([refiner.solid], one, fits.cam_from_obj, pairs, refiner.points[None]) / self.tolerance
        return Finalists(fits, alone, pairs, deep)

    def verified(self, finalists: Finalists) -> RefinedPoses:
        """Best first, without duplicates; of two that are inside each other one at most is believed."""
        return settled([self], [finalists])[0]

    def explained(self, cam_from_obj: Array, logit: Array) -> Array:
        """The share (n,) of each pose's support that better ones explain."""
        return explained([self], np.zeros(len(logit), np.int64), cam_from_obj, logit)

    def _apart(self, a: Array, b: Array) -> Array:
        """Distances (n,) of poses in thresholds."""
        return self.refiner.distance(a, b) / self.refiner.model.threshold


def turns(cam_from_obj: Array, center: Array, sides: int, angle: float) -> Array:
    """Poses (n * sides, 4, 4): each of n turned about its `center` (3,) by `angle` radians, to evenly spread sides."""
    turn = poses.from_axis_angle(sphere_directions(sides), np.full(sides, angle))
    rotation = turn @ cam_from_obj[:, None, :3, :3]
    middle = poses.apply(cam_from_obj, center[None])
    return poses.from_rotation_translation(rotation, middle - rotation @ center).reshape(-1, 4, 4)


def _best_of_each(evidence: Array, group: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """The `count` rows with the most evidence (n,) of each group (n,)."""
    order = np.lexsort((-evidence, group))
    begin = np.searchsorted(group[order], group[order])
    return np.asarray(order[np.arange(len(order)) - begin < count])
