"""Precision against recall: curves over images, and the figures read off them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from evalkit.scoring.matching import IGNORED, TRUE, Crowd, Matching

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
    start_recall: float = 0.0  # of finding nothing: above 0 where images have nothing to find

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

    def cut(self, score: float) -> Curve:
        """The points of at least this score; where there are none, that of finding nothing."""
        kept = self.score >= score
        if not kept.any():
            return _nothing_predicted(self.start_recall)
        return Curve(self.score[kept], self.precision[kept], self.recall[kept], self.start_recall)

    def recall_at_precision(self, precision: float) -> float:
        """The highest recall at which precision is at least this, 0 where it never is."""
        return float(self.recall[self.precision >= precision].max(initial=0.0))

    def recall_at_last_precision(self, precision: float) -> float:
        """The recall of the last point at which precision is at least this, 0 where it never is.

        What Siléane's toolbox reports: recall at the last crossing downwards. Recall may fall along the curve, where a
        nearer hypothesis takes an instance from one that was right.
        """
        reached = np.flatnonzero(self.precision >= precision)
        return float(self.recall[reached[-1]]) if len(reached) else 0.0


class Steps(Protocol):
    """What each image adds to a curve, ready to be added up with any weights of the images."""

    def curve(self, weights: Array | None = None) -> Curve:
        """The curve of the images, each counted `weights` (S,) times."""


@dataclass(frozen=True, eq=False)
class MeanSteps:
    """The protocol of Brégier et al. 2017: the mean over images of their curves, at every score of any image.

    In an image, precision is 1 where no hypothesis counts and recall is 1 where nothing is to be found. Both are steps
    in the score, so their means change only where some image has that score. Rows are sorted by falling score.
    """

    image: NDArray[np.int64]  # (n,)
    score: Array  # (n,)
    precision_change: Array  # (n,)
    recall_change: Array  # (n,)
    start_recall: Array  # (S,) before the first hypothesis

    @classmethod
    def of(cls, crowd: Crowd, matching: Matching) -> tuple[MeanSteps, Array]:
        """The steps, and the average precision (S,) of each image's own curve."""
        precision, recall = _precision_recall(crowd, matching)
        end = np.flatnonzero(_is_last(crowd.image, crowd.score))
        image, score, precision, recall = crowd.image[end], crowd.score[end], precision[end], recall[end]
        start = (crowd.wanted == 0).astype(float)
        first, last = _is_first(image), _is_last(image)
        area = recall * (precision - np.where(last, 0.0, np.roll(precision, -1)))
        per_image = np.where(crowd.hypotheses_per_image > 0, np.bincount(image, area, crowd.images), start)
        precision_change = precision - np.where(first, 1.0, np.roll(precision, 1))
        recall_change = recall - np.where(first, start[image], np.roll(recall, 1))
        order = np.argsort(-score, kind="stable")
        return cls(image[order], score[order], precision_change[order], recall_change[order], start), per_image

    def curve(self, weights: Array | None = None) -> Curve:
        weights = np.ones(len(self.start_recall)) if weights is None else weights
        total, start = weights.sum(), (weights * self.start_recall).sum()
        if not len(self.score):
            return _nothing_predicted(start / total)
        cut, weight = _is_last(self.score), weights[self.image]
        precision = _running_sum(total, weight * self.precision_change)[cut] / total
        recall = _running_sum(start, weight * self.recall_change)[cut] / total
        return Curve(self.score[cut], precision.astype(float), recall.astype(float), float(start / total))


@dataclass(frozen=True, eq=False)
class PooledSteps:
    """COCO's: one list of all images' hypotheses, by falling score."""

    image: NDArray[np.int64]  # (H,)
    score: Array  # (H,)
    true: NDArray[np.bool_]  # (H,)
    counted: NDArray[np.bool_]  # (H,) all but the ignored
    wanted: NDArray[np.int64]  # (S,) instances to find

    @classmethod
    def of(cls, crowd: Crowd, matching: Matching) -> tuple[PooledSteps, Array]:
        """The steps, and the interpolated AP (S,) of each image; NaN where nothing is to be found."""
        order = np.argsort(-crowd.score, kind="stable")
        outcome = matching.outcome[order]
        steps = cls(crowd.image[order], crowd.score[order], outcome == TRUE, outcome != IGNORED, crowd.wanted)
        return steps, _interpolated_per_image(crowd, matching)

    def curve(self, weights: Array | None = None) -> Curve:
        weights = np.ones(len(self.wanted)) if weights is None else weights
        wanted = (weights * self.wanted).sum()
        if not len(self.score):
            return _nothing_predicted(float(wanted == 0))
        cut, weight = _is_last(self.score), weights[self.image]
        true = np.cumsum(weight * self.true)[cut]
        counted = np.cumsum(weight * self.counted)[cut]
        return Curve(self.score[cut], _ratio(true, counted), _ratio(true, np.full(len(true), wanted)))


def _nothing_predicted(recall: float) -> Curve:
    return Curve(np.array([np.inf]), np.ones(1), np.array([recall]), recall)


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


def _ratio(part: NDArray[Any], whole: NDArray[Any]) -> Array:
    """part / whole of whole numbers, 1 where the whole is 0."""
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
