"""The rules of an evaluation, and how they are said to the reader of a score."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evalkit.datasets.scene import Share
from evalkit.datasets.visibility_share import in_words
from evalkit.errors import InputError
from evalkit.objects.model import ObjectModel
from evalkit.scoring.distances import CRITERIA

PROTOCOLS = {
    "sileane": "right where hypothesis and instance are each other's nearest, duplicates are wrong; precision and "
    "recall are means over images at each score, an image without predictions has none; AP is the area under the steps "
    "(Brégier et al. 2017)",
    "sileane-toolbox": "as the authors' toolbox: [vec(R Λ g); t] of the poses as given, images without predictions are "
    "skipped; right where hypothesis and instance are each other's nearest, duplicates are wrong; precision and "
    "recall are means over images at each score; AP is the area under the steps (Brégier et al. 2017)",
    "coco": "by falling score each hypothesis takes the nearest free instance; one curve over all images' hypotheses; "
    "AP is the mean of the interpolated precision at 101 recalls",
}


@dataclass(frozen=True)
class Settings:
    """The rules of an evaluation.

    Attributes:
        criterion: sym, add, adds, mssd or mspd.
        protocol: sileane, sileane-toolbox or coco.
        min_visibility: instances at least this visible are to be found; finding others is neither right nor wrong.
        threshold: a pose this close is right: in object diameters, for mspd in pixels of an image 640 wide.
        max_results: of each image only this many best hypotheses count; None for all.
        visibility: the share that `min_visibility` is of; None is the ground truth's own, where it does not say which.
    """

    criterion: str = "sym"
    protocol: str = "sileane"
    min_visibility: float = 0.5
    threshold: float = CRITERIA["sym"].threshold
    max_results: int | None = None
    visibility: Share | None = None

    def __post_init__(self) -> None:
        if self.criterion not in CRITERIA:
            raise InputError(f"criterion '{self.criterion}' is not known; use one of {', '.join(CRITERIA)}.")
        if self.protocol not in PROTOCOLS:
            raise InputError(f"protocol '{self.protocol}' is not known; use one of {', '.join(PROTOCOLS)}.")
        if self.protocol == "sileane-toolbox" and self.criterion != "sym":
            raise InputError("the protocol 'sileane-toolbox' knows the criterion 'sym' only; use --protocol sileane.")
        if not (np.isfinite(self.threshold) and self.threshold > 0):
            raise InputError(f"threshold {self.threshold:g} must be positive: object diameters, for mspd pixels.")
        if not -1.0 <= self.min_visibility <= 1.0:
            raise InputError(f"min-visibility {self.min_visibility:g} must be at most 1 (and 0 or less finds all).")
        if self.max_results is not None and self.max_results < 1:
            raise InputError(f"max-results {self.max_results} must be 1 or more.")

    def limit(self, model: ObjectModel) -> float:
        """The threshold in meters, for mspd in pixels."""
        return CRITERIA[self.criterion].limit(self.threshold, model)

    @property
    def asked(self) -> str:
        """Which instances are to be found, in words."""
        return at_least(self.min_visibility, self.visibility)

    def describe(self, model: ObjectModel) -> str:
        """The rules in words, figures included."""
        best = "" if self.max_results is None else f" The best {self.max_results} of an image count."
        return (
            f"{CRITERIA[self.criterion].describe(self.threshold, model)}; symmetry {model.symmetry.name}. "
            f"Instances {self.asked} are to be found, matches of others are ignored.{best} "
            f"Protocol {self.protocol}: {PROTOCOLS[self.protocol]}."
        )


def at_least(min_visibility: float, share: Share | None) -> str:
    """Such as "at least 50 % visible (geometric share)"."""
    return f"at least {100 * min_visibility:g} % visible ({in_words(share)})"
