"""What poses of one image mean for each other: whose depth speaks for whom, and who would be inside whom."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
DEEPEST = 4.0  # tolerances; beyond it makes no difference how deep


def neighbor_columns(
    alone: Array,  # (n,) log-odds
    agreement: Array,  # (n,)
    evidence: Array,  # (n,)
    share: Array,  # (n,) of a pose's support that better poses explain
    better: NDArray[np.bool_],  # (n,) those that count for others
    pairs: NDArray[np.int64],  # (p, 2)
    deep: Array,  # (p,) tolerances by which they interpenetrate
) -> dict[str, Array]:
    """The inputs of :attr:`posenet.refinement.judge.Judge.among`."""
    sure = 1.0 / (1.0 + np.exp(-alone))
    inside = np.zeros(len(alone))
    if len(pairs):
        first_better = alone[pairs[:, 0]] >= alone[pairs[:, 1]]
        winner, loser = np.where(first_better, pairs.T, pairs.T[::-1])
        counts = better[winner]
        np.maximum.at(inside, loser[counts], (np.minimum(deep, DEEPEST) * sure[winner])[counts])
    return {
        "alone": alone,
        "explained": share,
        "agreement explained": share * agreement,
        "inside a better one": inside,
        "touching a better one": np.minimum(inside, 1.0),
        "evidence left": evidence - share * agreement,
    }


def without_impossible_pairs(
    score: Array,  # (n,) probabilities
    pairs: NDArray[np.int64],  # (p, 2) that cannot both be
) -> Array:
    """Scores (n,) of which no such pair adds up to more than 1: best first, what one has is lost to those it excludes.

    So two poses inside each other are never both scored above 0.5.
    """
    score, excluded = score.copy(), np.zeros((len(score), len(score)), bool)
    excluded[pairs[:, 0], pairs[:, 1]] = excluded[pairs[:, 1], pairs[:, 0]] = True
    left = np.ones(len(score))
    for row in np.argsort(-score, kind="stable"):
        score[row] = min(score[row], left[row])
        left[excluded[row]] = np.minimum(left[excluded[row]], 1.0 - score[row])
    return score
