"""How good the predictions are: one call, one result that says by which rules it was reached."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.curves import Curve, mean_curve, pooled_curve
from evalkit.distances import CRITERIA, for_criterion
from evalkit.documents import GroundTruth, Predictions
from evalkit.errors import InputError
from evalkit.matching import DUPLICATE, FALSE, IGNORED, TRUE, Crowd, Matching, close_pairs, match_greedy, match_mutual
from evalkit.objects import THRESHOLD_RATIO

PROTOCOLS = ("sileane", "sileane-toolbox", "coco")
DIAMETER_TOLERANCE = 0.01  # of the diameter: two libraries' readings of one mesh agree far better, two units never
IMPLAUSIBLE_RATIO = 100.0  # a hypothesis this many times farther than every instance is in another unit


@dataclass(frozen=True)
class Settings:
    """The rules of an evaluation.

    Attributes:
        criterion: sym, add or adds.
        protocol: sileane, sileane-toolbox or coco.
        min_visibility: instances at least this visible are to be found; finding others is neither right nor wrong.
        threshold: times the object's diameter: a pose this close is right.
        max_results: of each image only this many best hypotheses count; None for all.
    """

    criterion: str = "sym"
    protocol: str = "sileane"
    min_visibility: float = 0.5
    threshold: float = THRESHOLD_RATIO
    max_results: int | None = None

    def __post_init__(self) -> None:
        if self.criterion not in CRITERIA:
            raise InputError(f"criterion '{self.criterion}' is not known; use one of {', '.join(CRITERIA)}.")
        if self.protocol not in PROTOCOLS:
            raise InputError(f"protocol '{self.protocol}' is not known; use one of {', '.join(PROTOCOLS)}.")
        if self.protocol == "sileane-toolbox" and self.criterion != "sym":
            raise InputError("the protocol 'sileane-toolbox' knows the criterion 'sym' only; use --protocol sileane.")
        if not (np.isfinite(self.threshold) and self.threshold > 0):
            raise InputError(f"threshold {self.threshold:g} must be a positive multiple of the object's diameter.")
        if not -1.0 <= self.min_visibility <= 1.0:
            raise InputError(f"min-visibility {self.min_visibility:g} must be at most 1 (and 0 or less finds all).")
        if self.max_results is not None and self.max_results < 1:
            raise InputError(f"max-results {self.max_results} must be 1 or more.")


@dataclass(frozen=True, eq=False)
class ImageOutcome:
    """What became of one image's hypotheses and instances, in the documents' order.

    Attributes:
        outcome: (h,) of each hypothesis: TRUE, IGNORED, DUPLICATE or FALSE of :mod:`evalkit.matching`; -1 where
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
    """The figures, the curve behind them, and the rules they follow."""

    settings: Settings
    object_name: str
    symmetry: str
    threshold_m: float
    curve: Curve
    ap: float
    image_ap: NDArray[np.float64]
    image_ids: list[str]
    missing_images: list[str]
    crowd: Crowd
    matching: Matching
    given: list[int]

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

    @property
    def protocol(self) -> str:
        """The rules in words."""
        return describe(self.settings, self.threshold_m, self.symmetry)

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
            "threshold": {"diameters": self.settings.threshold, "metres": self.threshold_m},
            "min_visibility": self.settings.min_visibility,
            "max_results": self.settings.max_results,
            "object": self.object_name,
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
    threshold: float = THRESHOLD_RATIO,
    max_results: int | None = None,
) -> Result:
    """Evaluate predictions against ground truth; see :class:`Settings` for the rules' meaning.

    Raises:
        InputError: a setting is unknown, or the two documents do not belong together.
    """
    settings = Settings(criterion, protocol, min_visibility, threshold, max_results)
    require_same_subject(predictions, truth)
    by_id = {image.id: image for image in predictions.images}
    missing = [image.id for image in truth.images if image.id not in by_id]
    toolbox = protocol == "sileane-toolbox"
    evaluated = [image for image in truth.images if image.id in by_id or not toolbox]
    if not evaluated:
        raise InputError(f"{predictions.source}: it has none of the images of {truth.source}; nothing to evaluate.")
    hypotheses = [by_id.get(image.id) for image in evaluated]
    crowd = Crowd.gather(hypotheses, evaluated, min_visibility, max_results)
    threshold_m = truth.object.threshold * (threshold / THRESHOLD_RATIO)
    pairs = close_pairs(crowd, for_criterion(criterion, truth.object, toolbox), threshold_m)
    matching = (match_greedy if protocol == "coco" else match_mutual)(crowd, pairs)
    curve, image_ap = (pooled_curve if protocol == "coco" else mean_curve)(crowd, matching)
    return Result(
        settings=settings,
        object_name=truth.object.name,
        symmetry=truth.object.symmetry.name,
        threshold_m=threshold_m,
        curve=curve,
        ap=curve.interpolated_average_precision if protocol == "coco" else curve.average_precision,
        image_ap=image_ap,
        image_ids=[image.id for image in evaluated],
        missing_images=missing,
        crowd=crowd,
        matching=matching,
        given=[0 if image is None else len(image.score) for image in hypotheses],
    )


def require_same_subject(predictions: Predictions, truth: GroundTruth) -> None:
    """Check that the documents speak of the same object, images, frame and unit.

    Raises:
        InputError: they do not; the sentence names both files.
    """
    where = f"{predictions.source}: "
    if predictions.object_name != truth.object.name:
        raise InputError(
            f"{where}its object is '{predictions.object_name}' but {truth.source} is about '{truth.object.name}'."
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
    reach = max((_reach(image.cam_from_obj) for image in truth.images), default=0.0)
    limit = IMPLAUSIBLE_RATIO * max(reach, truth.object.diameter)
    far = next((image for image in predictions.images if _reach(image.cam_from_obj) > limit), None)
    if far is not None:
        raise InputError(
            f"{predictions.source}: image '{far.id}': the field 't' holds {_reach(far.cam_from_obj):g} m where nothing "
            f"in {truth.source} lies beyond {reach:g} m; give metres, not millimetres."
        )


def _reach(pose: NDArray[np.float64]) -> float:
    return float(np.abs(pose[:, :3, 3]).max(initial=0.0))


def describe(settings: Settings, threshold_m: float, symmetry: str) -> str:
    """The rules in words, figures included."""
    distance = {
        "sym": f"Sym distance modulo the object's symmetry ({symmetry})",
        "add": "ADD, mean distance of corresponding model points (no symmetry is respected)",
        "adds": "ADD-S, mean distance of model points to the nearest estimated one",
    }[settings.criterion]
    rules = {
        "sileane": "right where hypothesis and instance are each other's nearest, duplicates are wrong; "
        "precision and recall are means over images at each score, an image without predictions has none; "
        "AP is the area under the steps (Brégier et al. 2017)",
        "sileane-toolbox": "as the authors' toolbox: [vec(R Λ g); t] of the poses as given, images without predictions "
        "are skipped; right where hypothesis and instance are each other's nearest; precision and recall are means "
        "over images at each score; AP is the area under the steps (Brégier et al. 2017)",
        "coco": "by falling score each hypothesis takes the nearest free instance; one curve over all images' "
        "hypotheses; AP is the mean of the interpolated precision at 101 recalls",
    }[settings.protocol]
    best = "" if settings.max_results is None else f" The best {settings.max_results} of an image count."
    return (
        f"{distance}, at most {settings.threshold:g} diameters = {1000 * threshold_m:.4g} mm. Instances at least "
        f"{100 * settings.min_visibility:g} % visible are to be found, matches of others are ignored.{best} "
        f"Protocol {settings.protocol}: {rules}."
    )


def evalkit_version() -> str:
    try:
        return version("binpose-evalkit")
    except PackageNotFoundError:  # run from a source tree that was never installed
        return "unknown"
