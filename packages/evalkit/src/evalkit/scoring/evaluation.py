"""How good the predictions are: one call, one result that says by which rules it was reached."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.documents import GroundTruth, GroundTruthImage, Predictions
from evalkit.errors import InputError
from evalkit.objects.model import THRESHOLD_RATIO, ObjectModel
from evalkit.scoring.curves import Curve, MeanSteps, PooledSteps, Steps
from evalkit.scoring.distances import CRITERIA, for_criterion
from evalkit.scoring.matching import (
    DUPLICATE,
    FALSE,
    IGNORED,
    TRUE,
    Crowd,
    Matching,
    Pairs,
    close_pairs,
    match_greedy,
    match_mutual,
)
from evalkit.scoring.rules import Settings

DIAMETER_TOLERANCE = 0.01  # of the diameter: two libraries' readings of one mesh agree far better, two units never
IMPLAUSIBLE_RATIO = 100.0  # a hypothesis this many times farther than every instance is in another unit


@dataclass(frozen=True, eq=False)
class ImageOutcome:
    """What became of one image's hypotheses and instances, in the documents' order.

    Attributes:
        outcome: (h,) of each hypothesis: TRUE, IGNORED, DUPLICATE or FALSE of :mod:`evalkit.scoring.matching`; -1 where
            max_results left it out.
        missed: (n,) whether the instance was to be found and was not.
        ignored: (n,) whether the instance is too hidden to be asked for.
        ap: the image's own average precision; NaN where it has none.
    """

    id: str
    outcome: NDArray[np.int8]
    missed: NDArray[np.bool_]
    ignored: NDArray[np.bool_]
    ap: float


@dataclass(frozen=True, eq=False)
class Result:
    """The figures, the curve behind them, and the rules they follow.

    Attributes:
        rules: in words.
        limit: the threshold in metres, for mspd in pixels.
        image_ap: (S,) each image's own AP; NaN where it has none.
        missing_images: ids of images that the predictions lack.
        given: of each image, how many hypotheses the predictions have, max_results or not.
    """

    settings: Settings
    object_name: str
    symmetry: str
    rules: str
    limit: float
    steps: Steps
    image_ap: NDArray[np.float64]
    image_ids: list[str]
    missing_images: list[str]
    crowd: Crowd
    matching: Matching
    given: list[int]

    @cached_property
    def curve(self) -> Curve:
        return self.steps.curve()

    @property
    def object_title(self) -> str:
        """The object's name to show a reader."""
        return self.object_name or "the object"

    @property
    def ap(self) -> float:
        return self.area(self.curve)

    def area(self, curve: Curve) -> float:
        """A curve's average precision as the protocol reads it."""
        return curve.interpolated_average_precision if self.settings.protocol == "coco" else curve.average_precision

    @property
    def map(self) -> float:
        """Mean of the images' own AP (in coco: of those with something to find)."""
        known = self.image_ap[~np.isnan(self.image_ap)]
        return float(known.mean()) if len(known) else self.ap

    @property
    def best_f1(self) -> float:
        return float(self.curve.f1.max())

    @property
    def recall_at_precision_99(self) -> float:
        return self.curve.recall_at_precision(0.99)

    @property
    def recall_at_precision_50(self) -> float:
        return self.curve.recall_at_precision(0.50)

    @cached_property
    def counts(self) -> dict[str, int]:
        """Numbers of images, instances and hypotheses; "false" includes the duplicates."""
        outcome = np.bincount(self.matching.outcome, minlength=4)
        found = self.matching.found_by >= 0
        return {
            "images": self.crowd.images,
            "images_without_prediction": len(self.missing_images),
            "instances": len(self.crowd.to_find),
            "instances_to_find": int(self.crowd.to_find.sum()),
            "hypotheses": len(self.crowd.score),
            "true": int(outcome[TRUE]),
            "false": int(outcome[FALSE] + outcome[DUPLICATE]),
            "duplicates": int(outcome[DUPLICATE]),
            "ignored": int(outcome[IGNORED]),
            "missed": int((self.crowd.to_find & ~found).sum()),
        }

    def at_confidence(self, score: float) -> tuple[float, float, float]:
        """Precision, recall and F1 of the hypotheses with at least this score."""
        curve = self.curve.cut(score)
        return float(curve.precision[-1]), float(curve.recall[-1]), float(curve.f1[-1])

    @property
    def protocol(self) -> str:
        """The rules in words."""
        return self.rules

    def images(self) -> list[ImageOutcome]:
        """What became of each image, in the ground truth's order."""
        hypotheses = np.searchsorted(self.crowd.image, np.arange(self.crowd.images + 1))
        instances = np.searchsorted(self.crowd.instance_image, np.arange(self.crowd.images + 1))
        return [
            self._image(number, slice(*hypotheses[number : number + 2]), slice(*instances[number : number + 2]))
            for number in range(self.crowd.images)
        ]

    def _image(self, number: int, hypotheses: slice, instances: slice) -> ImageOutcome:
        outcome = np.full(self.given[number], -1, np.int8)
        outcome[self.crowd.row[hypotheses]] = self.matching.outcome[hypotheses]
        wanted = self.crowd.to_find[instances]
        missed = wanted & (self.matching.found_by[instances] < 0)
        return ImageOutcome(self.image_ids[number], outcome, missed, ~wanted, float(self.image_ap[number]))

    def to_json(self) -> dict[str, Any]:
        """The figures, the rules and the curve; a score that is infinite (nothing predicted) is null."""
        curve = self.curve
        return {
            "ap": self.ap,
            "map": self.map,
            "best_f1": self.best_f1,
            "recall_at_precision_99": self.recall_at_precision_99,
            "recall_at_precision_50": self.recall_at_precision_50,
            "protocol": self.protocol,
            "protocol_name": self.settings.protocol,
            "criterion": self.settings.criterion,
            "threshold": (
                {"pixels": self.settings.threshold}
                if CRITERIA[self.settings.criterion].in_pixels
                else {"diameters": self.settings.threshold, "metres": self.limit}
            ),
            "min_visibility": self.settings.min_visibility,
            "max_results": self.settings.max_results,
            "object": self.object_name or None,
            "symmetry": self.symmetry,
            "counts": self.counts,
            "images_without_prediction": self.missing_images,
            "evalkit_version": evalkit_version(),
            "curve": {
                "score": [score if np.isfinite(score) else None for score in curve.score.tolist()],
                "precision": curve.precision.tolist(),
                "recall": curve.recall.tolist(),
            },
        }


def average_precision(
    predictions: Predictions,
    truth: GroundTruth,
    criterion: str = "sym",
    protocol: str = "sileane",
    min_visibility: float = 0.5,
    threshold: float | None = None,
    max_results: int | None = None,
) -> Result:
    """Evaluate predictions against ground truth; see :class:`Settings` for the rules' meaning.

    Args:
        threshold: None takes the criterion's own: 0.1 diameters, for mspd 10 pixels.

    Raises:
        InputError: a setting is unknown, or the two documents do not belong together.
    """
    if threshold is None:
        threshold = CRITERIA[criterion].threshold if criterion in CRITERIA else THRESHOLD_RATIO
    settings = Settings(criterion, protocol, min_visibility, threshold, max_results)
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
        limit, model = settings.limit(self.truth.object), self.truth.object
        if CRITERIA[settings.criterion].in_pixels and self.crowd.intrinsics is None:
            raise InputError(f"{self.truth.source}: an image has no 'camera', which --criterion mspd needs.")
        distance = for_criterion(settings.criterion, model, settings.protocol == "sileane-toolbox", limit)
        return close_pairs(self.crowd, distance, limit)

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


def require_same_subject(predictions: Predictions, truth: GroundTruth) -> None:
    """Check that the documents speak of the same object, images, frame and unit.

    Raises:
        InputError: they do not; the sentence names both files.
    """
    where = f"{predictions.source}: "
    names = predictions.object_name, truth.object.name
    if all(names) and names[0] != names[1]:
        raise InputError(
            f"{where}its object is '{predictions.object_name}' but {truth.source} is about '{truth.object.name}'; "
            "where they are one, give it one name: 'evalkit gt --object NAME', or 'simgen build --name NAME'."
        )
    diameter = predictions.object.get("diameter") if isinstance(predictions.object, dict) else None
    if diameter is not None and abs(diameter / truth.object.diameter - 1.0) > DIAMETER_TOLERANCE:
        raise InputError(
            f"{where}its object's 'diameter' is {diameter:g} m but that of {truth.source} is "
            f"{truth.object.diameter:g} m; evaluate on ground truth of the same object."
        )
    if predictions.frame != truth.frame:
        raise InputError(
            f"{where}its poses are in the {predictions.frame} frame but those of {truth.source} are in the "
            f"{truth.frame} frame; convert both with the same --camera-params."
        )
    known = {image.id for image in truth.images}
    unknown = next((image.id for image in predictions.images if image.id not in known), None)
    if unknown is not None:
        raise InputError(f"{where}image '{unknown}' is not in {truth.source}; use the ground truth of the same images.")
    _require_same_unit(predictions, truth)


def _require_same_unit(predictions: Predictions, truth: GroundTruth) -> None:
    model = truth.object
    reach = max((_reach(image.cam_from_obj, model) for image in truth.images), default=0.0)
    limit = IMPLAUSIBLE_RATIO * max(reach, model.diameter)
    far = next((image for image in predictions.images if _reach(image.cam_from_obj, model) > limit), None)
    if far is not None:
        away = _reach(far.cam_from_obj, model)
        raise InputError(
            f"{predictions.source}: image '{far.id}': the field 't' puts the object {away:g} m away where nothing in "
            f"{truth.source} lies beyond {reach:g} m; give metres, not millimetres."
        )


def _reach(pose: NDArray[np.float64], model: ObjectModel) -> float:
    """The largest coordinate of the parts' centroids; their frame's origin may lie anywhere."""
    return float(np.abs(model.centers(pose)).max(initial=0.0))


def evalkit_version() -> str:
    try:
        return version("binpose-evalkit")
    except PackageNotFoundError:  # run from a source tree that was never installed
        return "unknown"
