"""Precision against recall: curves over images, and the figures read off them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.matching import IGNORED, TRUE, Crowd, Matching

Array = NDArray[np.float64]
COCO_RECALLS = np.linspace(0.0, 1.0, 101)


@dataclass(frozen=True, eq=False)
class Curve:
    """Precision and recall of all hypotheses with at least some score, one point a distinct score, falling.

    Without any score there is one point, at an infinite score: precision 1, and the recall of finding nothing.
    """

    score: Array  # (n,)
    precision: Array  # (n,)
    recall: Array  # (n,)

    @property
    def average_precision(self) -> float:
        """Sum of p_i (r_i - r_{i-1}) with r_0 = 0: the area under the steps, no envelope (Brégier et al. 2017).

        Summed by parts, r_i (p_i - p_{i+1}) with p_{n+1} = 0, so that what is perfect is exactly 1.
        """
        return float((self.recall * -np.diff(self.precision, append=0.0)).sum())

    @property
    def interpolated_average_precision(self) -> float:
        """COCO's: the mean over 101 recalls of the best precision at that recall or beyond."""
        envelope = np.maximum.accumulate(self.precision[::-1])[::-1]
        reached = np.searchsorted(self.recall, COCO_RECALLS - 1e-12, side="left")
        return float(np.append(envelope, 0.0)[reached].mean())

    @property
    def f1(self) -> Array:
        """Harmonic mean of precision and recall at each point (n,)."""
        total = self.precision + self.recall
        return 2.0 * self.precision * self.recall / np.where(total > 0, total, 1.0)

    def recall_at_precision(self, precision: float) -> float:
        """The highest recall at which precision is at least this, 0 where it never is."""
        return float(self.recall[self.precision >= precision].max(initial=0.0))


def mean_curve(crowd: Crowd, matching: Matching) -> tuple[Curve, Array]:
    """The protocol of Brégier et al. 2017: the mean of the images' curves at every score, and each image's own AP.

    In an image, precision is 1 where no hypothesis counts and recall is 1 where nothing is to be found. Both are steps
    in the score, so their means change only where some image has that score.

    Returns:
        The mean curve, and the average precision (S,) of each image's own curve.
    """
    precision, recall = _precision_recall(crowd, matching)
    end = np.flatnonzero(_is_last(crowd.image, crowd.score))
    image, score, precision, recall = crowd.image[end], crowd.score[end], precision[end], recall[end]
    start = (crowd.wanted == 0).astype(float)
    first, last = _is_first(image), _is_last(image)
    area = recall * (precision - np.where(last, 0.0, np.roll(precision, -1)))
    per_image = np.where(crowd.hypotheses_per_image > 0, np.bincount(image, area, crowd.images), start)
    if not len(score):
        return Curve(np.array([np.inf]), np.ones(1), start.mean(keepdims=True)), per_image
    precision_change = precision - np.where(first, 1.0, np.roll(precision, 1))
    recall_change = recall - np.where(first, start[image], np.roll(recall, 1))
    order = np.argsort(-score, kind="stable")
    cut = _is_last(score[order])
    means = [
        _running_sum(initial, change[order])[cut] / crowd.images
        for initial, change in ((float(crowd.images), precision_change), (start.sum(), recall_change))
    ]
    return Curve(score[order][cut], means[0].astype(float), means[1].astype(float)), per_image


def pooled_curve(crowd: Crowd, matching: Matching) -> tuple[Curve, Array]:
    """COCO's: one list of all images' hypotheses, and each image's own interpolated AP.

    Returns:
        The curve, and the interpolated AP (S,) of each image; NaN where nothing is to be found.
    """
    order = np.argsort(-crowd.score, kind="stable")
    outcome = matching.outcome[order]
    cut = _is_last(crowd.score[order])
    true, ignored = (np.cumsum(outcome == kind)[cut] for kind in (TRUE, IGNORED))
    counted = np.arange(1, len(order) + 1)[cut] - ignored
    wanted = int(crowd.wanted.sum())
    curve = Curve(crowd.score[order][cut], _ratio(true, counted), _ratio(true, np.full(len(true), wanted)))
    if not len(order):
        curve = Curve(np.array([np.inf]), np.ones(1), np.array([float(wanted == 0)]))
    return curve, _interpolated_per_image(crowd, matching)


def _interpolated_per_image(crowd: Crowd, matching: Matching) -> Array:
    precision, recall = _precision_recall(crowd, matching)
    ends = np.searchsorted(crowd.image, np.arange(crowd.images + 1))
    result = np.full(crowd.images, np.nan)
    for image in np.flatnonzero(crowd.wanted):
        rows = slice(ends[image], ends[image + 1])
        cut = _is_last(crowd.score[rows])
        curve = Curve(crowd.score[rows][cut], precision[rows][cut], recall[rows][cut])
        result[image] = curve.interpolated_average_precision
    return result


def _precision_recall(crowd: Crowd, matching: Matching) -> tuple[Array, Array]:
    """Precision and recall (H,) of each image's hypotheses down to this one."""
    starts = np.searchsorted(crowd.image, np.arange(crowd.images))
    position = np.arange(len(crowd.image)) - starts[crowd.image] + 1
    counted = position - matching.ignored_so_far
    return _ratio(matching.true_so_far, counted), _ratio(matching.true_so_far, crowd.wanted[crowd.image])


def _ratio(part: NDArray[np.int64], whole: NDArray[np.int64]) -> Array:
    """part / whole, 1 where the whole is 0."""
    return np.where(whole > 0, part / np.maximum(whole, 1), 1.0)


def _running_sum(initial: float, changes: Array) -> NDArray[np.longdouble]:
    """In extended precision: after a million changes the last point is still right to the last bit."""
    return initial + np.cumsum(changes, dtype=np.longdouble)


def _is_first(*keys: NDArray[Any]) -> NDArray[np.bool_]:
    """Where a row begins a run of rows equal in all keys."""
    first = np.ones(len(keys[0]), bool)
    first[1:] = np.any([key[1:] != key[:-1] for key in keys], axis=0)
    return first


def _is_last(*keys: NDArray[Any]) -> NDArray[np.bool_]:
    """Where a row ends a run of rows equal in all keys."""
    return np.roll(_is_first(*keys), -1)
