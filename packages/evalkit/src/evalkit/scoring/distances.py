"""How far apart two poses of an object are: Sym, ADD and ADD-S, batched; and the list of all criteria.

Each distance also knows a point of the object and a `slack` such that ``distance >= |point_a - point_b| - slack``
whatever the rotations: pairs whose points lie farther apart than threshold + slack need never be computed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.objects.model import THRESHOLD_RATIO, ObjectModel
from evalkit.scoring.bop_distances import REFERENCE_WIDTH, Mspd, Mssd
from evalkit.scoring.model_points import describe_points, model_points

Array = NDArray[np.float64]
BLOCK_NUMBERS = 4_000_000  # float64 numbers held at once: 32 MB


class Distance(Protocol):
    """A distance between poses, row by row."""

    slack: float

    def points(self, cam_from_obj: Array) -> Array:
        """The point (n, 3) that bounds the distance from below, for poses (n, 4, 4)."""

    def __call__(self, estimate: Array, truth: Array, intrinsics: Array | None = None) -> Array:
        """Distances (n,) of poses (n, 4, 4) and (n, 4, 4); `intrinsics` (n, 5) are fx, fy, cx, cy, width."""


class Sym:
    """The geometrically right distance of Brégier et al. 2017, eq. 6-9, modulo the object's proper symmetries.

    The root mean square displacement of the surface's points, minimized over the symmetry group.
    """

    slack = 0.0

    def __init__(self, model: ObjectModel) -> None:
        self.model = model

    def points(self, cam_from_obj: Array) -> Array:
        return self.model.centers(cam_from_obj)

    def __call__(self, estimate: Array, truth: Array, intrinsics: Array | None = None) -> Array:
        return _in_blocks(self._distance, estimate, truth, 12 * len(self.model.symmetry.rotations))

    def _distance(self, estimate: Array, truth: Array) -> Array:
        return _nearest_representative(self.model.representatives(estimate), self.model.representatives(truth))


class SymToolbox:
    """Sym as the authors' toolbox computes it: [vec(R Lambda g); t] of the poses as they are given.

    Lambda and g are those of the inertial frame, but R and t map from the object's own frame, whose origin need not be
    the centroid. On the Siléane bunny, 7.8 mm off and 1 degree askew, poses 5 degrees apart differ from :class:`Sym` by
    up to 0.06 mm of 4.6, poses 180 degrees apart by 1.4 mm of 106; the reference results' AP is the same down to a
    threshold of 0.02 diameters, and .721 where it should be .742 at 0.015 (`benchmarks/speed/bench_evalkit.py`).
    """

    slack = 0.0

    def __init__(self, model: ObjectModel) -> None:
        self.model = model
        self.symmetry = model.symmetry.rotated(model.inertial_from_obj[:3, :3])

    def points(self, cam_from_obj: Array) -> Array:
        return cam_from_obj[:, :3, 3]

    def __call__(self, estimate: Array, truth: Array, intrinsics: Array | None = None) -> Array:
        return _in_blocks(self._distance, estimate, truth, 12 * len(self.symmetry.rotations))

    def _distance(self, estimate: Array, truth: Array) -> Array:
        return _nearest_representative(self._representatives(estimate), self._representatives(truth))

    def _representatives(self, pose: Array) -> Array:
        rotation, translation = pose[:, :3, :3], pose[:, :3, 3]
        if self.symmetry.kind != "finite":
            return self.symmetry.representatives(rotation, translation, self.model.lam)
        shape = (rotation[:, None] @ (self.model.lam @ self.symmetry.rotations)).reshape(len(pose), -1, 9)
        return np.concatenate([shape, np.broadcast_to(translation[:, None], (*shape.shape[:-1], 3))], -1)


class Add:
    """ADD (Hinterstoisser et al. 2012): the mean distance of corresponding model points. Knows no symmetry."""

    slack = 0.0

    def __init__(self, model: ObjectModel) -> None:
        self.model_points = model_points(model, "add")

    def points(self, cam_from_obj: Array) -> Array:
        return poses.apply(cam_from_obj, self.model_points.mean(0)[None])[:, 0]

    def __call__(self, estimate: Array, truth: Array, intrinsics: Array | None = None) -> Array:
        return _in_blocks(self._distance, estimate, truth, 3 * len(self.model_points))

    def _distance(self, estimate: Array, truth: Array) -> Array:
        displacement = poses.apply(estimate - truth, self.model_points)  # linear in the pose
        return np.asarray(np.linalg.norm(displacement, axis=-1).mean(-1))


class AddS:
    """ADD-S (Hinterstoisser et al. 2012): the mean distance of each true model point to the nearest estimated one."""

    def __init__(self, model: ObjectModel) -> None:
        from scipy.spatial import cKDTree  # slow to import, and no other criterion needs it

        self.model_points = model_points(model, "adds")
        self.center = self.model_points.mean(0)
        self.tree = cKDTree(self.model_points)
        self.slack = float(np.linalg.norm(self.model_points - self.center, axis=1).max())

    def points(self, cam_from_obj: Array) -> Array:
        return poses.apply(cam_from_obj, self.center[None])[:, 0]

    def __call__(self, estimate: Array, truth: Array, intrinsics: Array | None = None) -> Array:
        return _in_blocks(self._distance, estimate, truth, 3 * len(self.model_points))

    def _distance(self, estimate: Array, truth: Array) -> Array:
        in_estimate = poses.apply(poses.invert(estimate) @ truth, self.model_points)
        nearest, _ = self.tree.query(in_estimate, workers=-1)
        return np.asarray(nearest.mean(-1))


@dataclass(frozen=True)
class Criterion:
    """What the user may ask for: a distance and how its threshold is meant."""

    title: str
    words: str
    threshold: float  # the default
    in_pixels: bool = False
    over_points: bool = True  # whether it runs over model points

    def limit(self, threshold: float, model: ObjectModel) -> float:
        """The threshold in meters (or pixels), from one in diameters (or pixels)."""
        return threshold if self.in_pixels else threshold / THRESHOLD_RATIO * model.threshold

    def describe(self, threshold: float, model: ObjectModel) -> str:
        words = f"{self.words}, {describe_points(model)}" if self.over_points else self.words
        if self.in_pixels:
            return f"{words}, at most {threshold:g} px of an image {REFERENCE_WIDTH} px wide"
        limit_mm = 1000 * self.limit(threshold, model)
        return f"{words}, at most {threshold:g} diameters = {limit_mm:.4g} mm"


CRITERIA = {
    "sym": Criterion(
        "Sym", "Sym, root mean square motion of the surface modulo the object's symmetry", 0.1, over_points=False
    ),
    "add": Criterion("ADD", "ADD, mean distance of corresponding model points (no symmetry is respected)", 0.1),
    "adds": Criterion("ADD-S", "ADD-S, mean distance of model points to the nearest estimated one", 0.1),
    "mssd": Criterion("MSSD", "MSSD, largest motion of a model point modulo the object's symmetry", 0.1),
    "mspd": Criterion("MSPD", "MSPD, largest motion of a projected model point modulo symmetry", 10.0, in_pixels=True),
}


def for_criterion(criterion: str, model: ObjectModel, toolbox: bool = False, limit: float = np.inf) -> Distance:
    """The distance of that name; above `limit` it need not be exact, only above.

    Raises:
        InputError: the name is unknown, or the model lacks the points that the criterion needs.
    """
    if criterion == "sym":
        return SymToolbox(model) if toolbox else Sym(model)
    if criterion == "add":
        return Add(model)
    if criterion == "adds":
        return AddS(model)
    if criterion == "mssd":
        return Mssd(model, limit)
    if criterion == "mspd":
        return Mspd(model, limit)
    raise InputError(f"criterion '{criterion}' is not known; use one of {', '.join(CRITERIA)}.")


def sym_distance(model: ObjectModel, pose_a: ArrayLike, pose_b: ArrayLike) -> Array:
    """Sym distance in meters of poses (..., 4, 4) and (..., 4, 4), broadcast against each other."""
    a, b = np.broadcast_arrays(np.asarray(pose_a, float), np.asarray(pose_b, float))
    return Sym(model)(a.reshape(-1, 4, 4), b.reshape(-1, 4, 4)).reshape(a.shape[:-2])


def _nearest_representative(estimate: Array, truth: Array) -> Array:
    """Representatives (n, m, d) and (n, m, d) to distances (n,); any one of the second will do."""
    return np.asarray(np.linalg.norm(estimate - truth[:, :1], axis=-1).min(-1))


def _in_blocks(function: Callable[[Array, Array], Array], estimate: Array, truth: Array, numbers_a_row: int) -> Array:
    rows = max(1, BLOCK_NUMBERS // numbers_a_row)
    parts = [function(estimate[i : i + rows], truth[i : i + rows]) for i in range(0, len(estimate), rows)]
    return np.concatenate(parts) if parts else np.zeros(0)
