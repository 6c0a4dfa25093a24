"""Which poses of an image can be true together, be they of one part or of several that lie in one bin.

Poses were judged alone; now they compete, best first: a depth pixel speaks for one pose only, whichever part's (after
Aldoma et al. 2012, who do so for classical pipelines), and of two that would be inside each other at most one is
believed. So what looks like a cup on its own is none where a gear explains the same surface better. Everything is
counted in shares and tolerances of each part, so that poses of different parts are held against each other as those of
one are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from posenet.refinement.depth_evidence import ALREADY_EXPLAINED, explained_before
from posenet.refinement.fits import Finalists, RefinedPoses
from posenet.refinement.judge import probability
from posenet.refinement.neighbors import neighbor_columns, without_impossible_pairs
from posenet.refinement.solid import interpenetration

if TYPE_CHECKING:
    from posenet.refinement.refiner import Fitting

Array = NDArray[np.float64]


def settled(fittings: Sequence[Fitting], finalists: Sequence[Finalists]) -> list[RefinedPoses]:
    """What is kept of each part's finalists, best first, without duplicates.

    `fittings` are of one image, one a part.
    """
    counts = [len(those.fits.evidence) for those in finalists]
    part = np.repeat(np.arange(len(counts)), counts)
    own = [part == number for number in range(len(counts))]
    fits = finalists[0].fits
    for those in finalists[1:]:
        fits = fits.joined(those.fits)
    logit = _joined([f.refiner.judge.alone.logit(those.alone) for f, those in zip(fittings, finalists, strict=True)])
    share = explained(fittings, part, fits.cam_from_obj, logit)
    kept = share <= ALREADY_EXPLAINED
    pairs, deep = _all_pairs(fittings, finalists, part, fits.cam_from_obj)
    agreement = _joined([those.alone["agreement"] for those in finalists])
    among = neighbor_columns(logit, agreement, fits.evidence, share, kept, pairs, deep)
    sure = np.zeros(len(part))
    for fitting, rows in zip(fittings, own, strict=True):
        sure[rows] = probability(fitting.refiner.judge.among.logit(among))[rows]
    score = without_impossible_pairs(np.where(kept, sure, 0.0), pairs[deep > 1.0])
    order = np.argsort(-score, kind="stable")
    return [
        _kept(those, score[rows], order[(kept & rows)[order]] - np.argmax(rows))
        for those, rows in zip(finalists, own, strict=True)
    ]


def _kept(finalists: Finalists, score: Array, rows: NDArray[np.int64]) -> RefinedPoses:
    fits = finalists.fits.select(rows)
    return RefinedPoses(fits.cam_from_obj, fits.hypothesis, score[rows], fits.agreement, fits.violation)


def explained(fittings: Sequence[Fitting], part: NDArray[np.int64], cam_from_obj: Array, logit: Array) -> Array:
    """The share (n,) of each pose's support that better ones explain; `part` (n,) says which fitting's it is."""
    first, refiners = fittings[0], [fitting.refiner for fitting in fittings]
    share = explained_before(
        cam_from_obj,
        np.argsort(-logit, kind="stable"),
        part,
        np.stack([refiner.points for refiner in refiners]),
        np.stack([refiner.normals for refiner in refiners]),
        first.depth,
        first.intrinsics,
        np.array([fitting.tolerance for fitting in fittings]),
        np.array([refiner.spacing for refiner in refiners]),
    )
    return np.asarray(share)


def _all_pairs(
    fittings: Sequence[Fitting], finalists: Sequence[Finalists], part: NDArray[np.int64], cam_from_obj: Array
) -> tuple[NDArray[np.int64], Array]:
    """Pairs (p, 2) of poses that may touch, within each part and across, and by how many tolerances they are inside."""
    first = np.searchsorted(part, np.arange(len(finalists)))
    pairs = [those.pairs + start for those, start in zip(finalists, first, strict=True)]
    deep = [those.deep for those in finalists]
    if len(fittings) > 1:
        across = _close_across(fittings, part, cam_from_obj)
        solids, points = [f.refiner.solid for f in fittings], np.stack([f.refiner.points for f in fittings])
        tolerance = np.array([fitting.tolerance for fitting in fittings])[part[across]].mean(1)
        pairs.append(across)
        deep.append(interpenetration(solids, part, cam_from_obj, across, points) / tolerance)
    return np.concatenate(pairs), _joined(deep)


def _close_across(fittings: Sequence[Fitting], part: NDArray[np.int64], cam_from_obj: Array) -> NDArray[np.int64]:
    """Pairs (p, 2), first before second, of poses of different parts whose spheres meet."""
    models = [fitting.refiner.model for fitting in fittings]
    centers = np.concatenate([model.centers(cam_from_obj[part == number]) for number, model in enumerate(models)])
    radius = np.array([model.diameter / 2 for model in models])[part]
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=2)
    return np.argwhere(np.triu(apart < radius[:, None] + radius, 1) & (part[:, None] != part))


def _joined(columns: list[Array]) -> Array:
    return np.concatenate(columns)
