"""How good the predictions are: one call, one result that says by which rules it was reached."""

from __future__ import annotations

from dataclasses import dataclass

from evalkit.datasets.documents import GroundTruth, GroundTruthImage, Predictions
from evalkit.datasets.scene import Share
from evalkit.datasets.visibility_share import with_share
from evalkit.errors import InputError
from evalkit.objects.model import THRESHOLD_RATIO
from evalkit.scoring.agreement import require_same_subject
from evalkit.scoring.distances import CRITERIA, for_criterion
from evalkit.scoring.matching import (
    Crowd,
    Pairs,
    close_pairs,
    match_greedy,
    match_mutual,
)
from evalkit.scoring.precision_recall import MeanSteps, PooledSteps
from evalkit.scoring.result import Result
from evalkit.scoring.rules import Settings


def average_precision(
    predictions: Predictions,
    truth: GroundTruth,
    criterion: str = "sym",
    protocol: str = "sileane",
    min_visibility: float = 0.5,
    threshold: float | None = None,
    max_results: int | None = None,
    visibility: Share | None = None,
) -> Result:
    """Evaluate predictions against ground truth; see :class:`Settings` for the rules' meaning.

    Args:
        threshold: None takes the criterion's own: 0.1 diameters, for mspd 10 pixels.
        visibility: the share that decides what is to be found; None takes the one that the ground truth gives first.

    Raises:
        InputError: a setting is unknown, the two documents do not belong together, or the truth lacks the share.
    """
    if threshold is None:
        threshold = CRITERIA[criterion].threshold if criterion in CRITERIA else THRESHOLD_RATIO
    settings = Settings(criterion, protocol, min_visibility, threshold, max_results, visibility or truth.share)
    scene = Subject.of(predictions, truth, settings)
    return scene.score(settings, scene.pairs(settings))


@dataclass(frozen=True, eq=False)
class Subject:
    """Predictions and ground truth brought together: the images evaluated, and what is in them."""

    truth: GroundTruth
    evaluated: list[GroundTruthImage]
    missing: list[str]
    crowd: Crowd
    given: list[int]

    @classmethod
    def of(cls, predictions: Predictions, truth: GroundTruth, settings: Settings) -> Subject:
        require_same_subject(predictions, truth)
        truth = with_share(truth, settings.visibility)
        by_id = {image.id: image for image in predictions.images}
        skip = settings.protocol == "sileane-toolbox"
        evaluated = [image for image in truth.images if image.id in by_id or not skip]
        if not evaluated:
            raise InputError(f"{predictions.source}: it has none of the images of {truth.source}; nothing to evaluate.")
        hypotheses = [by_id.get(image.id) for image in evaluated]
        return cls(
            truth=truth,
            evaluated=evaluated,
            missing=[image.id for image in truth.images if image.id not in by_id],
            crowd=Crowd.gather(hypotheses, evaluated, settings.min_visibility, settings.max_results),
            given=[0 if image is None else len(image.score) for image in hypotheses],
        )

    def pairs(self, settings: Settings) -> Pairs:
        """Hypotheses and instances within the threshold.

        Raises:
            InputError: the criterion needs points or cameras that the ground truth lacks.
        """
        limit = settings.limit(self.truth.object)
        return self.pairs_within(settings.criterion, limit, settings.protocol == "sileane-toolbox")

    def pairs_within(self, criterion: str, limit: float, toolbox: bool = False) -> Pairs:
        """Hypotheses and instances no farther apart than `limit`, meters or for mspd pixels.

        Raises:
            InputError: as :meth:`pairs`.
        """
        if CRITERIA[criterion].in_pixels and self.crowd.intrinsics is None:
            raise InputError(f"{self.truth.source}: an image has no 'camera', which --criterion {criterion} needs.")
        return close_pairs(self.crowd, for_criterion(criterion, self.truth.object, toolbox, limit), limit)

    def score(self, settings: Settings, pairs: Pairs) -> Result:
        """Match by the protocol's rule and draw its curve."""
        coco = settings.protocol == "coco"
        matching = (match_greedy if coco else match_mutual)(self.crowd, pairs)
        steps, image_ap = (PooledSteps if coco else MeanSteps).of(self.crowd, matching)
        return Result(
            settings=settings,
            object_name=self.truth.object.name,
            symmetry=self.truth.object.symmetry.name,
            rules=settings.describe(self.truth.object),
            limit=settings.limit(self.truth.object),
            steps=steps,
            image_ap=image_ap,
            image_ids=[image.id for image in self.evaluated],
            missing_images=self.missing,
            crowd=self.crowd,
            matching=matching,
            given=self.given,
        )
