"""BOP's scores of 6D detection, of 2024 and 2025, as the benchmark's toolkit computes them: `eval_bop24_pose`.

Hodaň et al. 2024, "BOP Challenge 2024". AP is the mean over a ladder of thresholds: MSSD at 0.05 to 0.5 diameters, or
at 2 to 20 mm, and MSPD at 5 to 50 pixels of an image 640 wide. The toolkit's rules, which differ from COCO's:

* Of each image the best 100 estimates count, of the set xyzibd 200. Images that do not show the object do not count.
* By falling score each estimate takes the nearest instance that is free and *below* the threshold, however hidden.
  Only then are those ignored that took an instance less than 10 % visible.
* Each estimate is a point of the precision-recall curve, also where scores are tied: then order decides, as given.
* Precision is read at the 101 floating-point hundredths of recall: 140 of 200 found lies below the 71st of them.

Where the toolkit takes MSSD for infinite, because the origins of two poses lie a diameter apart, it is computed here;
this matters only for models whose origin lies outside of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.documents import GroundTruth, Predictions
from evalkit.datasets.scene import Share
from evalkit.datasets.visibility_share import holds, with_share
from evalkit.errors import InputError
from evalkit.objects.extent import largest_distance
from evalkit.objects.model import ObjectModel
from evalkit.scoring.evaluation import Subject
from evalkit.scoring.matching import IGNORED, TRUE, Crowd, Pairs, match_greedy
from evalkit.scoring.model_points import describe_points
from evalkit.scoring.precision_recall import COCO_RECALLS
from evalkit.scoring.result import evalkit_version
from evalkit.scoring.rules import Settings, at_least

MIN_VISIBILITY = 0.1
MOST_RESULTS, MOST_RESULTS_OF = 100, {"xyzibd": 200}
DIAMETERS = tuple(np.arange(0.05, 0.51, 0.05).tolist())
MILLIMETERS = tuple(float(mm) for mm in range(2, 21, 2))
PIXELS = tuple(float(px) for px in range(5, 51, 5))


@dataclass(frozen=True)
class DetectionAp:
    """AP by threshold, and what it was computed with.

    Attributes:
        mssd: by threshold in diameters; `mssd_mm` in millimeters, `mspd` in pixels.
        diameter: meters; `diameter_source` says whose.
        max_results: so many best estimates of an image count.
        visibility: the share that decides which instances are ignored; None where the ground truth does not say it.
        points: over which points of the model the distances run.
    """

    mssd: dict[float, float]
    mssd_mm: dict[float, float]
    mspd: dict[float, float]
    diameter: float
    diameter_source: str
    max_results: int
    visibility: Share | None
    points: str

    @property
    def scores(self) -> dict[str, float]:
        """By the names that BOP gives them."""
        mssd, mssd_mm, mspd = (float(np.mean(list(ladder.values()))) for ladder in self._ladders.values())
        return {
            "bop24_mAP": (mssd + mspd) / 2,
            "bop24_mAP_mssd": mssd,
            "bop24_mAP_mspd": mspd,
            "bop24_mAP_mssd_mm": mssd_mm,
            "bop25_mAP": mssd,
            "bop25_mAP_mm": mssd_mm,
        }

    @property
    def protocol(self) -> str:
        """The rules in words."""
        return (
            f"As bop_toolkit's eval_bop24_pose: mean AP at MSSD thresholds {DIAMETERS[0]:g} to {DIAMETERS[-1]:g} "
            f"diameters of {1000 * self.diameter:.4g} mm ({self.diameter_source}) or {MILLIMETERS[0]:g} to "
            f"{MILLIMETERS[-1]:g} mm, and MSPD thresholds {PIXELS[0]:g} to {PIXELS[-1]:g} px of an image 640 px wide, "
            f"{self.points}. The best {self.max_results} estimates of an image count, by falling score each takes the "
            f"nearest free instance, and only those count that took one {at_least(MIN_VISIBILITY, self.visibility)} "
            "or none; all images that show the object are pooled, precision is interpolated at 101 recalls. MSSD is "
            "computed where the toolkit takes it for infinite, the poses' origins being a diameter apart."
        )

    def to_json(self) -> dict[str, Any]:
        return {
            **self.scores,
            "protocol_name": "bop-toolkit",
            "protocol": self.protocol,
            "max_results": self.max_results,
            "min_visibility": MIN_VISIBILITY,
            "visibility": self.visibility,
            "diameter": self.diameter,
            **{key: {f"{at:g}": ap for at, ap in ladder.items()} for key, ladder in self._ladders.items()},
            "evalkit_version": evalkit_version(),
        }

    @property
    def _ladders(self) -> dict[str, dict[float, float]]:
        return {"mssd": self.mssd, "mssd_mm": self.mssd_mm, "mspd": self.mspd}


def detection_ap(
    predictions: Predictions, truth: GroundTruth, max_results: int | None = None, visibility: Share | None = None
) -> DetectionAp:
    """Evaluate by the scores of BOP 2024 and 2025.

    Args:
        max_results: so many best estimates of an image count; None for BOP's own number.
        visibility: None takes the geometric share, as BOP does, where the ground truth holds it.

    Raises:
        InputError: the documents do not belong together, the ground truth lacks cameras, model points or the share, or
            nothing is to be found.
    """
    if visibility is None and holds(truth, "geometric"):
        visibility = "geometric"
    truth = with_share(truth, visibility)
    model = truth.object
    diameter, source = _diameter(truth)
    if max_results is None:
        max_results = MOST_RESULTS_OF.get(str(model.notes.get("bop_dataset")), MOST_RESULTS)
    subject = Subject.of(predictions, truth, Settings("mssd", "coco", MIN_VISIBILITY, max_results=max_results))
    seen = np.concatenate([image.visibility for image in truth.images])
    crowd = replace(subject.crowd, to_find=seen >= MIN_VISIBILITY)  # without a tolerance, as the toolkit
    if not crowd.to_find.any():
        raise InputError(f"{truth.source}: no instance is at least 10 % visible; BOP has no score for that.")
    in_space = subject.pairs_within("mssd", max(DIAMETERS[-1] * diameter, MILLIMETERS[-1] / 1000))
    in_image = subject.pairs_within("mspd", PIXELS[-1])
    return DetectionAp(
        mssd={d: _average_precision(crowd, in_space, d * diameter) for d in DIAMETERS},
        mssd_mm={mm: _average_precision(crowd, in_space, mm / 1000) for mm in MILLIMETERS},
        mspd={px: _average_precision(crowd, in_image, px) for px in PIXELS},
        diameter=diameter,
        diameter_source=source,
        max_results=max_results,
        visibility=truth.share,
        points=describe_points(model),
    )


def _diameter(truth: GroundTruth) -> tuple[float, str]:
    """BOP's, in meters, and where it is from; that of our own documents is of a sphere, and a little larger."""
    model: ObjectModel = truth.object
    stated = model.notes.get("bop_diameter")
    if stated is not None:
        if isinstance(stated, bool) or not isinstance(stated, int | float) or not 0 < stated < np.inf:
            raise InputError(f"{truth.source}: object: notes: 'bop_diameter' must be a positive number of meters.")
        return float(stated), "as models_info.json states it"
    if model.vertices is not None:
        return largest_distance(model.finite_vertices), "the largest distance of two vertices"
    return model.diameter, "of the sphere around the centroid, as neither BOP's nor the vertices are known"


def _average_precision(crowd: Crowd, pairs: Pairs, threshold: float) -> float:
    """AP (one number) of all images' estimates, each a point of the curve."""
    near = pairs.distance < threshold
    close = Pairs(pairs.hypothesis[near], pairs.instance[near], pairs.distance[near])
    outcome = match_greedy(crowd, close, visible_first=False).outcome
    counts = (outcome != IGNORED) & (crowd.instances_per_image[crowd.image] > 0)
    order = np.argsort(-crowd.score[counts], kind="stable")
    true = np.cumsum(outcome[counts][order] == TRUE)
    return _interpolated(true / np.arange(1, len(true) + 1), true / crowd.to_find.sum())


def _interpolated(precision: NDArray[np.float64], recall: NDArray[np.float64]) -> float:
    """The mean over 101 recalls of the best precision at that recall or beyond, 0 where it is not reached."""
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float(np.append(envelope, 0.0)[np.searchsorted(recall, COCO_RECALLS, side="left")].mean())
