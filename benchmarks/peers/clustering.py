"""Raw hypotheses of one image become one pose an instance, as voting's authors do it: near ones add up their votes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from evalkit.scoring.distances import Sym

Array = NDArray[np.float64]
SAME = 0.15  # diameters of Sym: poses nearer than this to a cluster's strongest one belong to it
APART = 0.4  # diameters: the centers of two parts are never nearer, or they would be inside each other


def clustered(cam_from_obj: Array, votes: Array, model: ObjectModel) -> tuple[Array, Array]:
    """Cluster poses (n, 4, 4) with votes (n,): mean poses (m, 4, 4) and their sums of votes (m,), most first.

    A pose counts for one cluster, that of the strongest pose near it. Of two clusters that would be inside each other
    the weaker one is left out.
    """
    distance = Sym(model)
    free = np.ones(len(votes), bool)
    means, sums = [], []
    for strongest in np.argsort(-votes, kind="stable"):
        if not free[strongest]:
            continue
        near = free & (distance(cam_from_obj[strongest][None], cam_from_obj) < SAME * model.diameter)
        near[strongest] = True
        free &= ~near
        means.append(mean_pose(cam_from_obj[near], votes[near], cam_from_obj[strongest], model))
        sums.append(votes[near].sum())
    order = np.argsort(-np.array(sums), kind="stable")
    found, total = np.array(means).reshape(-1, 4, 4)[order], np.array(sums)[order]
    kept = apart(model.centers(found), APART * model.diameter)
    return found[kept], total[kept]


def mean_pose(cam_from_obj: Array, weight: Array, near: Array, model: ObjectModel) -> Array:
    """The weighted mean (4, 4) of poses (n, 4, 4), each as that of its equals that is nearest to the pose `near`."""
    turned = model.symmetry.closest_equivalent(cam_from_obj[:, :3, :3], near[:3, :3])
    share = weight / weight.sum()
    rotation = poses.nearest_rotation(np.einsum("n,nij->ij", share, turned))
    center = share @ model.centers(cam_from_obj)
    return np.asarray(poses.from_rotation_translation(rotation, center - rotation @ model.centroid))


def apart(centers: Array, least: float) -> NDArray[np.int64]:
    """The rows of centers (n, 3), best first, that are at least so far from every better one that is kept."""
    kept: list[int] = []
    for row, center in enumerate(centers):
        if not kept or np.linalg.norm(centers[kept] - center, axis=1).min() >= least:
            kept.append(row)
    return np.array(kept, np.int64)
