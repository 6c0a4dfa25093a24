"""What a model is worth on images without ground truth, by image evidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.documents import PredictionImage
from evalkit.depth.sources import DepthSource
from evalkit.evidence.verdict import Verdict, Verifier
from evalkit.evidence.verification import Verification, verify_image
from posenet.prediction.predictor import Predictor


@dataclass(frozen=True)
class Worth:
    """Poses scored at least 0.5 on some images; undecided ones do not count."""

    verified: int  # instances
    wrong: int  # contradicted, or a second pose of a part

    def f1(self, parts: int) -> float:
        """Of the poses, where `parts` are known to be there."""
        return 2 * self.verified / max(self.verified + self.wrong + max(parts, self.verified), 1)

    @property
    def precision(self) -> float:
        return self.verified / max(self.verified + self.wrong, 1)


def worth_of(predictor: Predictor, verifier: Verifier, source: DepthSource, numbers: list[int]) -> Worth:
    """What the predictor's poses on the images `numbers` of a source are worth."""
    images = []
    for number in numbers:
        depth, camera, name = source.depth(number), source.cameras[number], source.names[number]
        found = predictor.predict_batch([depth], camera, [name])[0]
        image = PredictionImage(name, found.cam_from_obj, found.score)
        images.append(verify_image(_best_of_detections(image, found.detection), depth, camera, verifier))
    whole = Verification(images, 0.5, predictor.model)
    return Worth(whole.count(Verdict.VERIFIED), whole.count(Verdict.CONTRADICTED) + whole.duplicates)


def _best_of_detections(image: PredictionImage, detection: NDArray[np.int64]) -> PredictionImage:
    """The surest hypothesis of each detection: the others are its alternatives."""
    _, first = np.unique(detection, return_index=True)  # sorted by score
    rows = np.sort(first)
    return PredictionImage(image.id, image.cam_from_obj[rows], image.score[rows])
