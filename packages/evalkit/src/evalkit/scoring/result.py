"""What an evaluation comes to: figures, the curve behind them, every image's outcome, and the rules they follow."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.scoring.distances import CRITERIA
from evalkit.scoring.matching import DUPLICATE, FALSE, IGNORED, TRUE, Crowd, Matching
from evalkit.scoring.precision_recall import Curve, Steps
from evalkit.scoring.rules import Settings


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
        limit: the threshold in meters, for mspd in pixels.
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
        return self._recall_at(0.99)

    @property
    def recall_at_precision_50(self) -> float:
        return self._recall_at(0.50)

    def _recall_at(self, precision: float) -> float:
        if self.settings.protocol == "sileane-toolbox":
            return self.curve.recall_at_last_precision(precision)
        return self.curve.recall_at_precision(precision)

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
            "visibility": self.settings.visibility,
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


def evalkit_version() -> str:
    try:
        return version("binpose-evalkit")
    except PackageNotFoundError:  # run from a source tree that was never installed
        return "unknown"
