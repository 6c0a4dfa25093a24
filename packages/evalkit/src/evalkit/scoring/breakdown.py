"""An evaluation taken apart: AP by criterion, by threshold and by visibility; how far off the poses are; each image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.documents import Predictions
from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from evalkit.scoring.distances import CRITERIA, Sym
from evalkit.scoring.evaluation import Subject
from evalkit.scoring.matching import (
    DUPLICATE,
    FALSE,
    IGNORED,
    TRUE,
    VISIBILITY_TOLERANCE,
    Pairs,
    close_pairs,
    match_mutual,
    within,
)
from evalkit.scoring.result import Result
from evalkit.scoring.rules import Settings

Array = NDArray[np.float64]
LADDER = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0)  # of a criterion's own threshold
VISIBILITY_BINS = 10


@dataclass(frozen=True)
class CriterionAp:
    """AP by one criterion at a threshold; `ap` is None where it cannot be computed, and `reason` says why."""

    criterion: str
    threshold: float
    ap: float | None
    reason: str = ""


@dataclass(frozen=True)
class VisibilityAp:
    """AP and recall where only instances with low <= visibility < high are to be found; NaN where there is none."""

    low: float
    high: float
    instances: int
    ap: float
    recall: float


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """How far the nearest hypothesis to each instance is off, modulo the object's symmetry.

    Attributes:
        rotation: (n,) radians.
        translation: (n,) meters, of the object's centroid.
        right: (n,) whether the hypothesis counts as true.
        instances: to find; those without a hypothesis nearby are missing from the arrays.
    """

    rotation: Array
    translation: Array
    right: NDArray[np.bool_]
    instances: int


@dataclass(frozen=True)
class ImageRow:
    """One image: its own AP over all scores (NaN where it has none), and counts."""

    id: str
    ap: float
    to_find: int
    true: int
    false: int
    ignored: int
    missed: int
    time_s: float | None


def by_criterion(subject: Subject, settings: Settings) -> list[CriterionAp]:
    """AP by every criterion, each at its own usual threshold, the one of `settings` at that of `settings`."""
    return [_ap_by(subject, settings, name) for name in CRITERIA]


def _ap_by(subject: Subject, settings: Settings, name: str) -> CriterionAp:
    threshold = settings.threshold if name == settings.criterion else CRITERIA[name].threshold
    try:
        rules = replace(settings, criterion=name, threshold=threshold)
        return CriterionAp(name, threshold, subject.score(rules, subject.pairs(rules)).ap)
    except InputError as error:
        return CriterionAp(name, threshold, None, str(error))


def by_threshold(subject: Subject, settings: Settings) -> list[tuple[float, float]]:
    """(threshold, AP) from strict to lax, the threshold of `settings` among them; distances are computed once."""
    usual = CRITERIA[settings.criterion].threshold
    ladder = sorted({settings.threshold, *(round(usual * step, 9) for step in LADDER)})
    rules = [replace(settings, threshold=threshold) for threshold in ladder]
    pairs = subject.pairs(rules[-1])
    scores = [subject.score(rule, within(pairs, rule.limit(subject.truth.object))) for rule in rules]
    return [(threshold, score.ap) for threshold, score in zip(ladder, scores, strict=True)]


def by_visibility(subject: Subject, settings: Settings) -> list[VisibilityAp]:
    """AP of ten equal bins of visibility, each over the images that show such an instance."""
    visibility = np.concatenate([np.zeros(0), *(image.visibility for image in subject.evaluated)])
    number = np.clip((visibility + VISIBILITY_TOLERANCE) * VISIBILITY_BINS, 0, VISIBILITY_BINS - 1).astype(int)
    pairs = subject.pairs(settings)
    return [_visibility_bin(subject, settings, pairs, index, number == index) for index in range(VISIBILITY_BINS)]


def _visibility_bin(
    subject: Subject, settings: Settings, pairs: Pairs, index: int, asked: NDArray[np.bool_]
) -> VisibilityAp:
    low, high = index / VISIBILITY_BINS, (index + 1) / VISIBILITY_BINS
    if not asked.any():
        return VisibilityAp(low, high, 0, np.nan, np.nan)
    result = replace(subject, crowd=replace(subject.crowd, to_find=asked)).score(settings, pairs)
    shown = (result.crowd.wanted > 0).astype(float)
    found = result.matching.found_by[asked] >= 0
    return VisibilityAp(low, high, int(asked.sum()), result.area(result.steps.curve(shown)), float(found.mean()))


def pose_errors(model: ObjectModel, result: Result) -> PoseErrors:
    """Errors of the hypotheses that `result` is of, each against the instance whose nearest one it is.

    Nearest by Sym distance, up to a diameter, and no farther than half a diameter apart: what lies beyond shows another
    object. So poses that are too far off to be true are seen as well, turned-over ones above all.
    """
    crowd = result.crowd
    near = close_pairs(crowd, Sym(model), model.diameter)
    offset = model.centers(crowd.pose[near.hypothesis]) - model.centers(crowd.instance_pose[near.instance])
    close = np.linalg.norm(offset, axis=-1) <= model.diameter / 2
    pairs = Pairs(near.hypothesis[close], near.instance[close], near.distance[close])
    found_by = match_mutual(crowd, pairs).found_by
    instance = np.flatnonzero((found_by >= 0) & crowd.to_find)
    hypothesis = found_by[instance]
    estimate, actual = crowd.pose[hypothesis], crowd.instance_pose[instance]
    turned = model.symmetry.closest_equivalent(actual[:, :3, :3], estimate[:, :3, :3])
    return PoseErrors(
        rotation=poses.rotation_angle(estimate[:, :3, :3], turned),
        translation=np.linalg.norm(model.centers(estimate) - model.centers(actual), axis=-1),
        right=result.matching.outcome[hypothesis] == TRUE,
        instances=int(crowd.to_find.sum()),
    )


def image_rows(result: Result, confident: Result, predictions: Predictions) -> list[ImageRow]:
    """The images, worst first: by AP, then by how many are missed, then by how many are false.

    Args:
        result: of all hypotheses: gives each image's AP.
        confident: of those that are acted on: gives the counts.
    """
    seconds = {image.id: image.time_s for image in predictions.images}
    rows = [
        ImageRow(
            id=whole.id,
            ap=whole.ap,
            to_find=int((~kept.ignored).sum()),
            true=int((kept.outcome == TRUE).sum()),
            false=int(np.isin(kept.outcome, (FALSE, DUPLICATE)).sum()),
            ignored=int((kept.outcome == IGNORED).sum()),
            missed=int(kept.missed.sum()),
            time_s=seconds.get(whole.id),
        )
        for whole, kept in zip(result.images(), confident.images(), strict=True)
    ]
    return sorted(rows, key=lambda row: (2.0 if np.isnan(row.ap) else row.ap, -row.missed, -row.false))
