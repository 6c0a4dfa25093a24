"""The detection score of BOP Challenge 2024: the mean AP over a ladder of MSSD and MSPD thresholds.

Hodaň et al. 2024, "BOP Challenge 2024"; AP as COCO's, 101 recalls, over all images; instances less than 10 % visible
are neither asked for nor wrong. MSSD at 0.05 to 0.5 diameters, or, for industrial objects, at 2 to 20 mm; MSPD at 5 to
50 pixels of an image 640 wide.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from evalkit.datasets.documents import GroundTruth, Predictions
from evalkit.errors import InputError
from evalkit.scoring.evaluation import Subject
from evalkit.scoring.matching import within
from evalkit.scoring.result import evalkit_version
from evalkit.scoring.rules import Settings

MIN_VISIBILITY = 0.1
DIAMETERS = tuple(float(d) for d in np.round(np.arange(1, 11) * 0.05, 2))
MILLIMETERS = tuple(float(mm) for mm in range(2, 21, 2))
PIXELS = tuple(float(px) for px in range(5, 51, 5))
UNITS = ("diameter", "mm")


@dataclass(frozen=True)
class DetectionAp:
    """AP by threshold; `unit` says what MSSD's thresholds are in."""

    unit: str
    mssd: dict[float, float]
    mspd: dict[float, float]

    @property
    def ap_mssd(self) -> float:
        return float(np.mean(list(self.mssd.values())))

    @property
    def ap_mspd(self) -> float:
        return float(np.mean(list(self.mspd.values())))

    @property
    def ap(self) -> float:
        return (self.ap_mssd + self.ap_mspd) / 2

    @property
    def protocol(self) -> str:
        unit, last = ("diameters", DIAMETERS[-1]) if self.unit == "diameter" else ("mm", MILLIMETERS[-1])
        first = DIAMETERS[0] if self.unit == "diameter" else MILLIMETERS[0]
        return (
            f"BOP 2024 detection: mean of COCO's AP (101 recalls, all images pooled) at MSSD thresholds {first:g} to "
            f"{last:g} {unit} and MSPD thresholds {PIXELS[0]:g} to {PIXELS[-1]:g} px of an image 640 px wide; "
            f"instances less than {100 * MIN_VISIBILITY:g} % visible are ignored."
        )

    def to_json(self) -> dict[str, Any]:
        return {
            "ap": self.ap,
            "ap_mssd": self.ap_mssd,
            "ap_mspd": self.ap_mspd,
            "protocol": self.protocol,
            "mssd_unit": self.unit,
            "mssd": {f"{threshold:g}": ap for threshold, ap in self.mssd.items()},
            "mspd": {f"{threshold:g}": ap for threshold, ap in self.mspd.items()},
            "evalkit_version": evalkit_version(),
        }


def detection_ap(predictions: Predictions, truth: GroundTruth, unit: str = "diameter") -> DetectionAp:
    """Evaluate by BOP 2024's detection score.

    Raises:
        InputError: the documents do not belong together, or the ground truth lacks cameras or model points.
    """
    if unit not in UNITS:
        raise InputError(f"unit '{unit}' is not known; use one of {', '.join(UNITS)}.")
    per_diameter = 0.1 / truth.object.threshold  # the threshold is 0.1 diameters
    mssd = {d: d for d in DIAMETERS} if unit == "diameter" else {mm: mm / 1000 * per_diameter for mm in MILLIMETERS}
    return DetectionAp(
        unit=unit,
        mssd=_ladder(predictions, truth, "mssd", mssd),
        mspd=_ladder(predictions, truth, "mspd", {px: px for px in PIXELS}),
    )


def _ladder(
    predictions: Predictions, truth: GroundTruth, criterion: str, thresholds: dict[float, float]
) -> dict[float, float]:
    """AP at each threshold; distances are computed once, at the widest."""
    widest = Settings(criterion, "coco", MIN_VISIBILITY, max(thresholds.values()))
    subject = Subject.of(predictions, truth, widest)
    pairs = subject.pairs(widest)
    scores = {}
    for name, threshold in thresholds.items():
        settings = replace(widest, threshold=threshold)
        scores[name] = subject.score(settings, within(pairs, settings.limit(truth.object))).ap
    return scores
